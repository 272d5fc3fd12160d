"""Run jobs on an executor as they are needed, and yield the result of each."""

from __future__ import annotations

import math
import os
import socket
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from functools import cached_property, partial
from hashlib import sha256
from itertools import count, islice
from multiprocessing import parent_process
from operator import length_hint
from queue import Empty, SimpleQueue
from statistics import median
from typing import Any, Generic, NamedTuple, TypeVar

from dynident.runtime.errors import BudgetedFunction, InputError
from dynident.runtime.jobs.job import (
    JobOutcome,
    JobResult,
    Limits,
    Status,
    attempt,
    limit_threads,
    pack,
    run_call,
    unpack,
)
from dynident.runtime.jobs.workers import local_workers, runner_of_thread

# s: least and most work of a batch, of which two for each worker are lost when all stops
MIN_BATCH_SECONDS, MAX_BATCH_SECONDS = 0.2, 10.0
MAX_BATCH_JOBS = 1000  # jobs in a batch
MAX_LOST_SHARE = 0.05  # of the time that may be lost between jobs
DECAY = 0.8  # what is measured counts that much less with each further batch
LOST_BATCHES = 31  # batches that show what one costs
BATCHES_AHEAD = 2  # batches of each worker that are under way
MAX_CACHED_FUNCTIONS = 4  # functions that a process remembers

_FUNCTIONS: dict[bytes, _WorkerFunction] = {}
_LAST = threading.local()  # ``run`` of the batch before, and when this worker had ``ended`` it

J = TypeVar("J")
T = TypeVar("T")
MAX_FIRST_FAILURES = 3  # batches that fail before any is done: so will all
TICK_SECONDS = 1.0  # s; on Windows Ctrl-C does not interrupt a wait


class Pace:
    """Sizes of batches, from 1 by doubling up to a work of 20 times what is lost with each.

    ``workers`` is how many there may be; those that are ``seen`` count when they are more.
    """

    def __init__(self, workers: int) -> None:
        self._workers, self._seen = workers, set[Hashable]()
        self._largest, self._jobs, self._seconds = 1, 0.0, 0.0
        self._lost: deque[float] = deque(maxlen=LOST_BATCHES)

    @property
    def workers(self) -> int:
        """How many there are."""
        return max(self._workers, len(self._seen))

    @property
    def ahead(self) -> int:
        """How many batches are under way at a time."""
        return BATCHES_AHEAD * self.workers

    def size(self, remaining: int | None = None) -> int:
        """Return the number of jobs of the next batch, where ``remaining`` jobs (None: unknown) are left."""
        if not self._jobs:
            return 1
        lost = median(self._lost) if self._lost else 0.0
        # enough work that the time lost with a batch stays below its share
        work = min(max(lost * (1 / MAX_LOST_SHARE - 1), MIN_BATCH_SECONDS), MAX_BATCH_SECONDS)
        mean = max(self._seconds / self._jobs, 1e-9)
        # near the end, small batches let all workers finish together
        share = MAX_BATCH_JOBS if remaining is None else math.ceil(remaining / self.ahead)
        return max(1, min(MAX_BATCH_JOBS, 2 * self._largest, int(work / mean), share))

    def record_batch(self, worker: Hashable, jobs: int, seconds: float, lost: float | None) -> None:
        """Record a batch that has ended: its jobs took ``seconds``, and further seconds were ``lost`` before it."""
        self._seen.add(worker)
        self._largest = max(self._largest, jobs)
        self._jobs = DECAY * self._jobs + jobs
        self._seconds = DECAY * self._seconds + seconds
        if lost is not None:
            self._lost.append(lost)


class Batch(NamedTuple):
    """Pickled jobs for a worker, and their function.

    The function is given by its digest, and whole where the worker may not know it. ``run`` and ``number`` tell a
    batch from all others, also for executors that run equal calls only once.
    """

    run: str
    number: int
    digest: bytes
    function: bytes | None
    jobs: Sequence[bytes]
    limits: Limits


class BatchReport(NamedTuple):
    """The ``outcomes`` of the jobs of a batch; ``lost``: seconds since the last batch of this run without a job."""

    worker: tuple[str, int, int]
    outcomes: Sequence[JobOutcome]
    lost: float | None


@dataclass(frozen=True)
class _WorkerFunction:
    """A function as it was received, loaded when it is first called here."""

    content: bytes

    @cached_property
    def itself(self) -> Callable[[Any], Any]:
        """The function, loaded when it is first called; InputError where that fails."""
        try:
            function: Callable[[Any], Any] = unpack(self.content)
        except Exception as error:
            raise InputError(
                f"a worker cannot load the function of the jobs: {type(error).__name__}: {error}; define it in a "
                "module that can be imported there."
            ) from error
        if parent_process() is not None:  # a worker
            limit_threads()
        return function


def run_batch(batch: Batch) -> BatchReport | None:
    """Run jobs in this thread or in its worker process; None where the function is not known here."""
    if (function := _cached_function(batch)) is None:
        return None
    if runner := runner_of_thread(batch.limits):
        outcomes = runner.run(function.content, batch.jobs, batch.limits)
    else:
        outcomes = [attempt(function.itself, job) for job in batch.jobs]
    # time between the batches of one run in which this worker had nothing to do
    before, now = _LAST.ended if getattr(_LAST, "run", None) == batch.run else None, time.monotonic()
    _LAST.run, _LAST.ended = batch.run, now
    lost = None if before is None else max(now - before - sum(outcome.seconds for outcome in outcomes), 0.0)
    return BatchReport((socket.gethostname(), os.getpid(), threading.get_ident()), outcomes, lost)


def _cached_function(batch: Batch) -> _WorkerFunction | None:
    if (function := _FUNCTIONS.get(batch.digest)) is not None:
        return function
    if batch.function is None:
        return None
    # forget the oldest functions, which may hold large data
    for old in list(_FUNCTIONS)[: 1 - MAX_CACHED_FUNCTIONS]:
        _FUNCTIONS.pop(old, None)
    return _FUNCTIONS.setdefault(batch.digest, _WorkerFunction(batch.function))


def run_jobs(
    function: Callable[[J], T],
    jobs: Iterable[J],
    executor: Executor | None = None,
    *,
    limits: Limits | None = None,
) -> Iterator[JobResult[J, T]]:
    """Yield the result of each job as it ends, in any order: the value of ``function``, or why there is none.

    ``function`` and what it holds go to a worker once; jobs should be small. Both must be picklable where an
    ``executor`` is given, or ``limits``, for which the jobs run in worker processes of their own; else the jobs
    run in this process, one after the other. ``jobs`` are taken as they are needed, so that there may be any
    number. An exception of a job is a result; Ctrl-C ends all. Raises InputError where the workers cannot run any
    job, or a process of a ``ProcessPoolExecutor`` has died, and ConfigError where the budget of memory is no
    number.
    """
    limits = limits or Limits()
    if executor is not None:
        yield from _Dispatcher(function, jobs, executor, limits).results()
    elif limits == Limits():
        yield from (JobResult(job, *run_call(partial(function, job))) for job in jobs)
    else:
        with local_workers(1) as local_executor:
            yield from _Dispatcher(function, jobs, local_executor, limits).results()


class _Dispatcher(Generic[J, T]):
    """Jobs on their way to the workers of an executor and back."""

    def __init__(self, function: Callable[[J], T], jobs: Iterable[J], executor: Executor, limits: Limits) -> None:
        self._function = pack(BudgetedFunction(function))
        self._digest = sha256(self._function).digest()
        self._jobs, self._rest = iter(jobs), length_hint(jobs, -1)
        self._executor, self._limits = executor, limits
        # there is no public name for the number of workers; more are seen when they answer
        self._pace = Pace(getattr(executor, "_max_workers", None) or os.cpu_count() or 1)
        self._under_way: dict[Future[BatchReport | None], list[J]] = {}
        self._again: deque[list[J]] = deque()  # with the function
        self._ended: SimpleQueue[Future[BatchReport | None]] = SimpleQueue()
        self._answered, self._failed = False, 0
        self._run, self._numbers = uuid.uuid4().hex, count()

    def results(self) -> Iterator[JobResult[J, T]]:
        """Yield the results of jobs as they end."""
        try:
            while self._fill():
                future = self._next_finished()
                yield from self._take_report(future, self._under_way.pop(future))
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
        # until the first answer one batch per worker, which shows whether the function can be loaded at all
        while len(self._under_way) < (self._pace.ahead if self._answered else self._pace.workers):
            if self._again:
                self._submit(self._again.popleft(), with_function=True)
            elif jobs := list(islice(self._jobs, self._pace.size(None if self._rest < 0 else self._rest))):
                self._rest = max(self._rest - len(jobs), 0) if self._rest >= 0 else -1
                self._submit(jobs, with_function=not self._answered)
            else:
                break
        return bool(self._under_way)

    def _submit(self, jobs: list[J], *, with_function: bool) -> None:
        function = self._function if with_function else None
        packed_jobs = [pack(job) for job in jobs]
        batch = Batch(self._run, next(self._numbers), self._digest, function, packed_jobs, self._limits)
        future = self._executor.submit(run_batch, batch)
        self._under_way[future] = jobs
        future.add_done_callback(self._ended.put)

    def _next_finished(self) -> Future[BatchReport | None]:
        while True:
            try:
                return self._ended.get(timeout=TICK_SECONDS)
            except Empty:
                continue

    def _take_report(self, future: Future[BatchReport | None], jobs: list[J]) -> Iterator[JobResult[J, T]]:
        try:
            report = future.result()
        except (BrokenExecutor, InputError):
            raise
        except CancelledError as error:
            raise InputError("the executor has given up jobs; are its workers still there?") from error
        except Exception as error:  # of the executor, since those of jobs are results
            yield from self._retry_singly(jobs, error)
            return
        # the worker has not got the function (any more): send the batch again with it
        if report is None:
            self._again.append(jobs)
            return
        self._answered = True
        self._pace.record_batch(
            report.worker, len(jobs), sum(outcome.seconds for outcome in report.outcomes), report.lost
        )
        for job, job_outcome in zip(jobs, report.outcomes, strict=True):
            yield _unpack_outcome(job, job_outcome)

    def _retry_singly(self, jobs: list[J], error: Exception) -> Iterator[JobResult[J, T]]:
        """Retry the jobs of a failed batch one by one; a job that fails alone has ended its worker."""
        self._failed += 1
        if not self._answered and self._failed == MAX_FIRST_FAILURES:
            raise InputError(f"workers cannot run jobs: {type(error).__name__}: {error}") from error
        if len(jobs) > 1:
            self._again.extend([job] for job in jobs)
        else:
            yield JobResult(jobs[0], None, Status.DIED, f"{type(error).__name__}: {error}")


def _unpack_outcome(job: J, outcome: JobOutcome) -> JobResult[J, Any]:
    if outcome.status is not Status.OK:
        return JobResult(job, None, outcome.status, outcome.reason, outcome.seconds)
    value, status, reason, _ = run_call(partial(unpack, outcome.value))
    return JobResult(job, value, status, reason, outcome.seconds)
