"""Runs jobs on an executor, as they are asked for, and yields what becomes of each."""

from __future__ import annotations

import os
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from itertools import count, islice
from operator import length_hint
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeVar

from dynident.errors import GIGABYTE, InputError, budgeted, give, memory
from dynident.jobs.attempt import Ended, tried
from dynident.jobs.batch import Batch, Report, run_batch
from dynident.jobs.job import Done, Limits, Status
from dynident.jobs.pace import Pace
from dynident.jobs.packed import packed, unpacked
from dynident.jobs.workers import local_workers

__all__ = ["run_jobs"]

J = TypeVar("J")
T = TypeVar("T")
HOPELESS = 3  # batches that fail before any is done: so will all
TICK = 1.0  # s; on Windows Ctrl-C does not interrupt a wait


def run_jobs(
    function: Callable[[J], T],
    jobs: Iterable[J],
    executor: Executor | None = None,
    *,
    limits: Limits | None = None,
) -> Iterator[Done[J, T]]:
    """Yield each job as it ends, in any order, with the value of ``function`` or why there is none.

    ``function`` and what it holds go to a worker once; jobs should be small. Both must be picklable where an
    ``executor`` is given, or ``limits``, for which the jobs run in worker processes of their own; else the jobs run in
    this process, one after the other. ``jobs`` are taken as they are needed, so that there may be any number. An
    exception of a job is a result; Ctrl-C ends all. Raises InputError where the workers cannot run any job, or a
    process of a ``ProcessPoolExecutor`` has died, and ConfigError where the budget of memory is no number.
    """
    limits = limits or Limits()
    if executor is not None:
        yield from _Spread(function, jobs, executor, limits).done()
    elif limits == Limits():
        yield from (Done(job, *tried(partial(function, job))) for job in jobs)
    else:
        with local_workers(1) as one:
            yield from _Spread(function, jobs, one, limits).done()


@dataclass(frozen=True)
class _Within(Generic[J, T]):
    """A function with the budget of memory (GB) of the run that asks for it, which no worker knows."""

    function: Callable[[J], T]
    gigabytes: float

    def __call__(self, job: J) -> T:
        with budgeted():
            give(self.gigabytes)
            return self.function(job)


class _Spread(Generic[J, T]):
    """Jobs on their way to the workers of an executor and back."""

    def __init__(self, function: Callable[[J], T], jobs: Iterable[J], executor: Executor, limits: Limits) -> None:
        self._function = packed(_Within(function, memory() / GIGABYTE))
        self._digest = sha256(self._function).digest()
        self._jobs, self._rest = iter(jobs), length_hint(jobs, -1)
        self._executor, self._limits = executor, limits
        # there is no public name for the number of workers; more are seen when they answer
        self._pace = Pace(getattr(executor, "_max_workers", None) or os.cpu_count() or 1)
        self._under_way: dict[Future[Report | None], list[J]] = {}
        self._again: deque[list[J]] = deque()  # with the function
        self._ended: SimpleQueue[Future[Report | None]] = SimpleQueue()
        self._answered, self._failed = False, 0
        self._run, self._numbers = uuid.uuid4().hex, count()

    def done(self) -> Iterator[Done[J, T]]:
        """Yield jobs as they end."""
        try:
            while self._fill():
                future = self._next()
                yield from self._taken(future, self._under_way.pop(future))
        except BrokenExecutor as error:
            raise InputError(
                "a worker process has died, perhaps for want of memory, and its executor with it. Take fewer workers, "
                "or give jobs limits, with which each has a process of its own."
            ) from error
        finally:
            for future in self._under_way:
                future.cancel()

    def _fill(self) -> bool:
        """Submit jobs; return whether any are under way."""
        while len(self._under_way) < (self._pace.ahead if self._answered else self._pace.workers):
            if self._again:
                self._submit(self._again.popleft(), whole=True)
            elif jobs := list(islice(self._jobs, self._pace.size(None if self._rest < 0 else self._rest))):
                self._rest = max(self._rest - len(jobs), 0) if self._rest >= 0 else -1
                self._submit(jobs, whole=not self._answered)
            else:
                break
        return bool(self._under_way)

    def _submit(self, jobs: list[J], *, whole: bool) -> None:
        function = self._function if whole else None
        given = [packed(job) for job in jobs]
        batch = Batch(self._run, next(self._numbers), self._digest, function, given, self._limits)
        future = self._executor.submit(run_batch, batch)
        self._under_way[future] = jobs
        future.add_done_callback(self._ended.put)

    def _next(self) -> Future[Report | None]:
        while True:
            try:
                return self._ended.get(timeout=TICK)
            except Empty:
                continue

    def _taken(self, future: Future[Report | None], jobs: list[J]) -> Iterator[Done[J, T]]:
        try:
            report = future.result()
        except (BrokenExecutor, InputError):
            raise
        except CancelledError as error:
            raise InputError("the executor has given up jobs; are its workers still there?") from error
        except Exception as error:  # of the executor, since those of jobs are results
            yield from self._refused(jobs, error)
            return
        if report is None:
            self._again.append(jobs)
            return
        self._answered = True
        self._pace.saw(report.worker, len(jobs), sum(one.seconds for one in report.ended), report.lost)
        for job, ended in zip(jobs, report.ended, strict=True):
            yield _read(job, ended)

    def _refused(self, jobs: list[J], error: Exception) -> Iterator[Done[J, T]]:
        """Try the jobs of a batch one by one; one that fails alone has died with its worker."""
        self._failed += 1
        if not self._answered and self._failed == HOPELESS:
            raise InputError(f"workers cannot run jobs: {type(error).__name__}: {error}") from error
        if len(jobs) > 1:
            self._again.extend([job] for job in jobs)
        else:
            yield Done(jobs[0], None, Status.DIED, f"{type(error).__name__}: {error}")


def _read(job: J, ended: Ended) -> Done[J, Any]:
    if ended.status is not Status.OK:
        return Done(job, None, ended.status, ended.reason, ended.seconds)
    value, status, reason, _ = tried(partial(unpacked, ended.value))
    return Done(job, value, status, reason, ended.seconds)
