"""Worker processes of this machine as an executor, and the process for the jobs of a thread of any executor."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import ModuleType

from dynident.runtime.errors import InputError
from dynident.runtime.jobs.job import ONE_THREAD, JobOutcome, Limits, Status, WorkOrder, serve

# a nanny of Dask sets it, and giving memory back each time costs a fit 40 % more CPU
TRIM_VARIABLE = "MALLOC_TRIM_THRESHOLD_"
MAX_TRIES = 2  # of a job whose process dies: it may have been killed for want of memory of all

# that nearly every job needs; no threads come with it
PRELOADED_MODULES = "numpy", "scipy.linalg", "dynident.identification"

_START_LOCK = threading.RLock()


@contextmanager
def _start_conditions() -> Iterator[None]:
    """Set what a new process inherits: one thread of BLAS, Ctrl-C blocked, no script to import, the right to exist."""
    with _START_LOCK:
        process, script = multiprocessing.current_process(), sys.modules["__main__"]
        is_daemon, signals = process.daemon, _block_interrupt()
        # safe path: a numpy.py where the user stands is not imported
        changes: dict[str, str | None] = {**ONE_THREAD, "PYTHONSAFEPATH": "1", TRIM_VARIABLE: None}
        environment = {name: os.environ.get(name) for name in changes}
        try:
            _update_environment(changes)
            process.daemon = False  # workers of Dask are daemons, which may start none
            sys.modules["__main__"] = ModuleType("__main__")
            yield
        finally:
            sys.modules["__main__"], process.daemon = script, is_daemon
            _update_environment(environment)
            if os.name == "posix":
                signal.pthread_sigmask(signal.SIG_SETMASK, signals)


def _block_interrupt() -> set[int]:
    """Block Ctrl-C for this thread, and for the processes that it starts; return the signals blocked before."""
    if os.name != "posix":
        return set()
    from multiprocessing.resource_tracker import ensure_running

    ensure_running()  # when it is started, it unblocks Ctrl-C
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}))


def _update_environment(values: Mapping[str, str | None]) -> None:
    """Set environment variables; None removes one."""
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


@dataclass(frozen=True)
class _Worker:
    """A worker process, and the connection to it."""

    process: BaseProcess
    connection: Connection


def _start_worker(preload: Sequence[str]) -> _Worker:
    """Start a worker; on Linux it is forked from a server that has imported the first ``preload`` of all."""
    # a forked process has no way to the server of its parent
    is_main = multiprocessing.parent_process() is None
    context = multiprocessing.get_context("forkserver" if sys.platform == "linux" and is_main else "spawn")
    own_end, worker_end = context.Pipe()
    with worker_end, _start_conditions():
        context.set_forkserver_preload([*preload])
        process = context.Process(target=serve, args=(worker_end, preload), daemon=True)  # type: ignore[attr-defined]
        try:
            process.start()
        except (OSError, EOFError) as error:
            own_end.close()
            raise InputError(f"no worker process can be started: {error}.") from error
    return _Worker(process, own_end)


class Runner:
    """A worker process for jobs of one thread.

    It is started when it is needed, and anew after it died, was killed at the limit of time, or ran out of memory; the
    job that it was at is the only one that is lost.
    """

    def __init__(self, preload: Iterable[str]) -> None:
        self._preload = (*PRELOADED_MODULES, *preload)
        self._worker: _Worker | None = None
        self._function = b""  # that the process has
        self._stopped = False

    def run(self, function: bytes, jobs: Sequence[bytes], limits: Limits) -> list[JobOutcome]:
        """Return the outcome of each job; InputError where the process cannot run any."""
        outcomes: list[JobOutcome] = []
        tries = 0
        while len(outcomes) < len(jobs):
            # one pass per process: jobs that are not answered when it dies go to the next
            try:
                for outcome in self._answers(function, jobs[len(outcomes) :], limits):
                    outcomes.append(outcome)
                    tries = 0
            except TimeoutError:
                self.close()
                seconds = limits.seconds or 0.0
                outcomes.append(JobOutcome(Status.TIMED_OUT, seconds, reason=f"longer than the limit of {seconds:g} s"))
            except (EOFError, OSError):
                tries += 1
                code = self.close()
                if tries == MAX_TRIES:
                    outcomes.append(JobOutcome(Status.DIED, 0.0, reason=_death(code)))
                    tries = 0
        return outcomes

    def _answers(self, function: bytes, jobs: Sequence[bytes], limits: Limits) -> Iterator[JobOutcome]:
        connection = self._send_order(function, jobs, limits)
        for _ in jobs:
            # the second look takes an answer that came just as the time ran out
            if limits.seconds is not None and not (wait([connection], limits.seconds) or wait([connection], 0)):
                raise TimeoutError
            outcome = JobOutcome(*connection.recv())
            yield outcome
            if outcome.status is Status.OUT_OF_MEMORY:
                self.close()
                return

    def _send_order(self, function: bytes, jobs: Sequence[bytes], limits: Limits) -> Connection:
        """Send an order to the process; return its connection when it has begun the first job."""
        for _ in range(MAX_TRIES):
            connection = self._start()
            sent_function = None if function == self._function else function
            try:
                connection.send(tuple(WorkOrder(sent_function, limits.memory, jobs)))
                refusal = connection.recv()
            except (EOFError, OSError):
                code = self.close()
                continue
            if refusal:
                raise InputError(refusal)
            self._function = function
            return connection
        raise InputError(f"a worker process ends before it runs any job: {_death(code)}.")

    def _start(self) -> Connection:
        """Return the connection to the process, which is started if there is none."""
        with _START_LOCK:
            if self._stopped:
                raise InputError("no worker process can be started: its executor is closed.")
            self._worker = self._worker or _start_worker(self._preload)
            return self._worker.connection

    def close(self) -> int:
        """End the process; return its exit code."""
        worker, self._worker, self._function = self._worker, None, b""
        if worker is None:
            return 0
        worker.connection.close()
        worker.process.kill()
        worker.process.join()
        return worker.process.exitcode or 0

    def stop(self) -> None:
        """End the process, and start no other; from any thread."""
        with _START_LOCK:
            self._stopped = True
            if (worker := self._worker) is not None:
                worker.process.kill()

    def __del__(self) -> None:
        if self._worker is not None:  # the process ends by that; more might wait for what this thread itself holds
            self._worker.connection.close()


def _death(code: int) -> str:
    if code >= 0:
        return f"its process has ended with exit code {code}"
    return f"its process was killed by signal {-code}, perhaps for want of memory"


class _ThreadState(threading.local):
    """The state of a thread: the process for its jobs."""

    runner: Runner | None = None
    process: int = 0  # that of the thread: a process that is forked inherits all this, but not the runner's


_THREAD_STATE = _ThreadState()


@contextmanager
def local_workers(count: int, preload: Iterable[str] = ()) -> Iterator[Executor]:
    """Give an executor for ``run_jobs``, whose jobs run in ``count`` processes of this machine.

    Each has one thread of BLAS, ends with this process, however that ends, and ignores Ctrl-C, which is for this one.
    ``preload`` are the names of modules that are imported before the first job, on Linux once for all. What is
    submitted to the executor otherwise than by ``run_jobs`` runs in threads of this process.
    """
    if count < 1:
        raise InputError(f"{count} workers can do no work; take at least 1.")
    runners: list[Runner] = []
    pool = ThreadPoolExecutor(count, "dynident-worker", lambda: runners.append(assign_process(preload)))
    try:
        yield pool
        pool.shutdown()
    finally:
        for runner in runners:
            runner.stop()  # ends the jobs that are left
        pool.shutdown(cancel_futures=True)
        for runner in runners:
            runner.close()


def runner_of_thread(limits: Limits) -> Runner | None:
    """Return the process for the jobs of this thread; None where they run in this one, which has no ``limits``."""
    # a forked process inherits this thread's state, but its worker belongs to the parent
    if _THREAD_STATE.process != os.getpid():
        _THREAD_STATE.runner = None
    return _THREAD_STATE.runner if limits == Limits() else assign_process()


def assign_process(preload: Iterable[str] = ()) -> Runner:
    """Give this thread a process for its jobs, with one thread of BLAS, that may die without it; return it."""
    if _THREAD_STATE.runner is None or _THREAD_STATE.process != os.getpid():
        _THREAD_STATE.runner, _THREAD_STATE.process = Runner(preload), os.getpid()
    return _THREAD_STATE.runner
