"""Worker processes of this machine as an executor, and the process for the jobs of a thread of any executor."""

from __future__ import annotations

import atexit
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from threading import Lock
from typing import Any, Protocol

from dynident.runtime.errors import InputError
from dynident.runtime.jobs.job import NUMBER_BYTES, JobOutcome, Limits, Status, WorkOrder

ONE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "POLARS_MAX_THREADS"), "1"
)  # before NumPy is loaded
# a nanny of Dask sets it, and giving memory back each time costs a fit 40 % more CPU
TRIM_VARIABLE = "MALLOC_TRIM_THRESHOLD_"
END_SECONDS = 2.0  # s for a server to end its workers
MAX_TRIES = 2  # of a job whose process dies: it may have been killed for want of memory of all

# that nearly every job needs; no threads come with it
PRELOADED_MODULES = "numpy", "scipy.linalg", "dynident.identification"

_LOCK = threading.Lock()
_SHARED_STARTERS: dict[int, Starter] = {}  # by process: what starts those of threads of foreign executors


@dataclass(frozen=True)
class Child:
    """A worker process: its ``connection``, and ``end``, which kills it and returns its exit code."""

    connection: Connection
    end: Callable[[], int]


class Starter(Protocol):
    """Starts worker processes, from any thread."""

    def start(self) -> Child:
        """Start one."""

    def close(self) -> None:
        """End all that it has started."""


def starter(preload: Iterable[str]) -> Starter:
    """Return what starts workers: on Linux they are forked from a server that has imported ``preload``."""
    return ForkServer(preload) if sys.platform == "linux" else SpawnStarter()


def _python(call: str, **options: Any) -> subprocess.Popen[bytes]:
    """Start Python to call a function of ``job``."""
    code = f"import sys; sys.path[:] = {list(map(str, sys.path))}; from dynident.runtime.jobs import job; job.{call}"
    environment = {name: value for name, value in os.environ.items() if name != TRIM_VARIABLE} | ONE_THREAD
    command = [sys.executable, "-c", code]
    try:
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, env=environment, **options)  # noqa: S603 -- of our own
    except OSError as error:
        raise InputError(f"no worker process can be started: {error}.") from error


class SpawnStarter:
    """Starts each worker as a new Python, which takes as long as its imports, on any system."""

    def __init__(self) -> None:
        self._processes: set[subprocess.Popen[bytes]] = set()

    def start(self) -> Child:
        """Start one."""
        own_end, worker_end = Pipe()
        # the worker inherits only its end of the pipe; ours closes when this process ends, which ends the worker
        with worker_end:
            handle = worker_end.fileno()
            if sys.platform == "win32":
                os.set_handle_inheritable(handle, True)
                options: Any = {
                    "startupinfo": subprocess.STARTUPINFO(lpAttributeList={"handle_list": [handle]}),
                    "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP,
                }
            else:
                options = {"pass_fds": (handle,), "start_new_session": True}
            process = _python(f"serve_at({handle}, {os.getpid()})", **options)
        self._processes.add(process)
        return Child(own_end, partial(self._end, process))

    def _end(self, process: subprocess.Popen[bytes]) -> int:
        process.kill()
        self._processes.discard(process)
        return process.wait()

    def close(self) -> None:
        """End all."""
        for process in list(self._processes):
            self._end(process)


class ForkServer:
    """Forks workers from one process that has imported everything, which takes some milliseconds each."""

    def __init__(self, preload: Iterable[str]) -> None:
        self._preload = tuple(preload)
        self._lock, self._closed = Lock(), False
        self._launch()

    def _launch(self) -> None:
        self._control, server_end = socket.socketpair()
        with server_end:
            call = f"fork_server({server_end.fileno()}, {self._preload})"
            self._process = _python(call, pass_fds=(server_end.fileno(),), start_new_session=True)
        self._used = False

    def start(self) -> Child:
        """Fork one."""
        own_end, worker_end = Pipe()
        with worker_end, self._lock:
            try:
                number = self._request_fork(worker_end)
            except OSError as error:
                own_end.close()
                raise InputError(f"no worker process can be started: {error}.") from error
            self._used = True
        return Child(own_end, partial(self._end, number))

    def _request_fork(self, worker_end: Connection) -> int:
        try:
            return self._ask(0, [worker_end.fileno()])
        except OSError:
            if self._closed:
                raise
            # somebody killed the server: start another one, once
            self._stop()  # it was killed; the workers that it had go on
            self._launch()
            return self._ask(0, [worker_end.fileno()])

    def _end(self, number: int) -> int:
        with self._lock:
            try:
                return self._ask(number)
            except OSError:
                if not self._closed:  # the server was killed
                    with suppress(OSError):
                        os.kill(number, signal.SIGKILL)
                return -signal.SIGKILL

    def _ask(self, number: int, descriptors: Iterable[int] = ()) -> int:
        socket.send_fds(self._control, [number.to_bytes(NUMBER_BYTES, "little")], list(descriptors))
        if not (answer := self._control.recv(NUMBER_BYTES)):
            raise ConnectionError("the process that starts them has ended")
        return int.from_bytes(answer, "little", signed=True)

    def close(self) -> None:
        """End all."""
        self._closed = True
        with suppress(OSError):
            self._control.shutdown(socket.SHUT_RDWR)  # it ends its workers; who waits for an answer waits no more
        with self._lock:
            self._stop()

    def _stop(self) -> None:
        self._control.close()
        if not self._used:  # it may still be at its imports, and has no workers
            self._process.kill()
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class Runner:
    """A worker process for jobs of one thread.

    It is started when it is needed, and anew after it died, was killed at the limit of time, or ran out of memory; the
    job that it was at is the only one that is lost.
    """

    def __init__(self, starter: Starter) -> None:
        self._starter = starter
        self._child: Child | None = None
        self._function = b""  # that the process has

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
            child = self._child = self._child or self._starter.start()
            sent_function = None if function == self._function else function
            try:
                child.connection.send(tuple(WorkOrder(sent_function, limits.memory, jobs)))
                refusal = child.connection.recv()
            except (EOFError, OSError):
                code = self.close()
                continue
            if refusal:
                raise InputError(refusal)
            self._function = function
            return child.connection
        raise InputError(f"a worker process ends before it runs any job: {_death(code)}.")

    def close(self) -> int:
        """End the process; return its exit code."""
        child, self._child, self._function = self._child, None, b""
        if child is None:
            return 0
        child.connection.close()
        return child.end()

    def __del__(self) -> None:
        if self._child is not None:  # the process ends by that; more might wait for what this thread itself holds
            self._child.connection.close()


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
    ``preload`` are the names of modules that are imported once for all. What is submitted to the executor otherwise
    than by ``run_jobs`` runs in threads of this process.
    """
    if count < 1:
        raise InputError(f"{count} workers can do no work; take at least 1.")
    process_starter = starter((*PRELOADED_MODULES, *preload))
    runners: list[Runner] = []

    def assign_runner() -> None:
        _THREAD_STATE.runner, _THREAD_STATE.process = Runner(process_starter), os.getpid()
        runners.append(_THREAD_STATE.runner)

    pool = ThreadPoolExecutor(count, "dynident-worker", assign_runner)
    try:
        yield pool
        pool.shutdown()
    finally:
        process_starter.close()  # ends the jobs that are left
        pool.shutdown(cancel_futures=True)
        for runner in runners:
            runner.close()


def runner_of_thread(limits: Limits) -> Runner | None:
    """Return the process for the jobs of this thread; None where they run in this one, which has no ``limits``."""
    # a forked process inherits this thread's state, but its worker belongs to the parent
    if _THREAD_STATE.process != os.getpid():
        _THREAD_STATE.runner = None
    if limits != Limits():
        assign_process()
    return _THREAD_STATE.runner


def assign_process(preload: Iterable[str] = ()) -> None:
    """Give this thread a process for its jobs, with one thread of BLAS, that may die without it.

    The first of the threads determines what is imported for all.
    """
    if _THREAD_STATE.runner is None or _THREAD_STATE.process != os.getpid():
        _THREAD_STATE.runner, _THREAD_STATE.process = Runner(_shared_starter(preload)), os.getpid()


def _shared_starter(preload: Iterable[str]) -> Starter:
    with _LOCK:
        if os.getpid() not in _SHARED_STARTERS:
            _SHARED_STARTERS[os.getpid()] = process_starter = starter((*PRELOADED_MODULES, *preload))
            atexit.register(process_starter.close)
        return _SHARED_STARTERS[os.getpid()]
