"""Worker processes of this machine as an executor; and the process that a thread of any executor has for its jobs."""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager

from dynident.errors import InputError
from dynident.jobs.job import Limits
from dynident.jobs.processes import Starter, starter
from dynident.jobs.runner import Runner

__all__ = ["local_workers", "own_process", "runner_of_thread"]

HEAVY = ("numpy", "scipy.linalg", "dynident.identification")  # that nearly every job needs; no threads come with it


class _Own(threading.local):
    """What a thread has: the process for its jobs."""

    runner: Runner | None = None
    process: int = 0  # that of the thread: a process that is forked inherits all this, but not the runner's


_OWN = _Own()
_LOCK = threading.Lock()
_SHARED: dict[int, Starter] = {}  # by process: what starts those of threads of foreign executors


@contextmanager
def local_workers(count: int, preload: Iterable[str] = ()) -> Iterator[Executor]:
    """Give an executor for ``run_jobs``, whose jobs run in ``count`` processes of this machine.

    Each has one thread of BLAS, ends with this process, however that ends, and ignores Ctrl-C, which is for this one.
    ``preload`` are the names of modules that are imported once for all. What is submitted to the executor otherwise
    than by ``run_jobs`` runs in threads of this process.
    """
    if count < 1:
        raise InputError(f"{count} workers can do no work; take at least 1.")
    start = starter((*HEAVY, *preload))
    runners: list[Runner] = []

    def own() -> None:
        _OWN.runner, _OWN.process = Runner(start), os.getpid()
        runners.append(_OWN.runner)

    pool = ThreadPoolExecutor(count, "dynident-worker", own)
    try:
        yield pool
        pool.shutdown()
    finally:
        start.close()  # ends the jobs that are left
        pool.shutdown(cancel_futures=True)
        for runner in runners:
            runner.close()


def runner_of_thread(limits: Limits) -> Runner | None:
    """Return the process for the jobs of this thread; None where they run in this one, which has no ``limits``."""
    if _OWN.process != os.getpid():
        _OWN.runner = None
    if limits != Limits():
        own_process()
    return _OWN.runner


def own_process(preload: Iterable[str] = ()) -> None:
    """Give this thread a process for its jobs, with one thread of BLAS, that may die without it; the first of the
    threads says what is imported for all."""
    if _OWN.runner is None or _OWN.process != os.getpid():
        _OWN.runner, _OWN.process = Runner(_shared(preload)), os.getpid()


def _shared(preload: Iterable[str]) -> Starter:
    with _LOCK:
        if os.getpid() not in _SHARED:
            _SHARED[os.getpid()] = found = starter((*HEAVY, *preload))
            atexit.register(found.close)
        return _SHARED[os.getpid()]
