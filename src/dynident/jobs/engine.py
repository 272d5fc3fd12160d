"""Runs jobs on an executor, as they are asked for, and yields what becomes of each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import TypeVar

from dynident.jobs.job import Done, Limits, Status

__all__ = ["run_jobs"]

J = TypeVar("J")
T = TypeVar("T")
AHEAD = 8  # jobs that are submitted and not done


def run_jobs(
    function: Callable[[J], T],
    jobs: Iterable[J],
    executor: Executor | None = None,
    *,
    limits: Limits | None = None,  # noqa: ARG001
) -> Iterator[Done[J, T]]:
    """Yield each job as it ends, in any order, with the value of ``function`` or why there is none.

    ``function`` and what it holds go to a worker once; jobs should be small. Both must be picklable where an
    ``executor`` is given; else the jobs run in this process, one after the other. ``jobs`` are taken as they are
    needed, so that there may be any number. An exception of a job is a result; Ctrl-C ends all.
    """
    if executor is None:
        yield from (_run(function, job) for job in jobs)
        return
    source, waiting = iter(jobs), set[Future[Done[J, T]]]()
    try:
        while True:
            while len(waiting) < AHEAD:
                try:
                    job = next(source)
                except StopIteration:
                    break
                waiting.add(executor.submit(_run, function, job))
            if not waiting:
                return
            ended, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for one in ended:
                yield one.result()
    finally:
        for one in waiting:
            one.cancel()


def _run(function: Callable[[J], T], job: J) -> Done[J, T]:
    began = time.perf_counter()
    try:
        return Done(job, function(job), seconds=time.perf_counter() - began)
    except Exception as error:  # a result, whatever it is
        return Done(job, None, Status.FAILED, f"{type(error).__name__}: {error}", time.perf_counter() - began)
