"""What becomes of a job, and what limits it."""

from __future__ import annotations

import io
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import import_module
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from types import FunctionType
from typing import Any, Generic, NamedTuple, NoReturn, TypeVar

from dynident.runtime.errors import InputError

# of a module that no other process can import by its name: what gets a name of it there
REBUILDER = "__dynident_again__"

J = TypeVar("J")
T = TypeVar("T")

ONE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "POLARS_MAX_THREADS"), "1"
)  # before NumPy is loaded
MIN_JOB_BYTES = 16_000_000  # bytes that a job needs at least


def pack(obj: Any) -> bytes:
    """Return an object pickled, by cloudpickle (where installed) if only this process knows it, such as a lambda.

    Classes and functions of a module with the attribute ``REBUILDER``, a callable that can be pickled, become a
    call of it with their name.
    """
    try:
        pickled = _dump(pickle.Pickler, obj)
        # what is of __main__ pickles by its name, which another process does not know
        if b"__main__" not in pickled:
            return pickled
    except (pickle.PicklingError, AttributeError, TypeError):
        pickled = b""
    try:
        cloud_pickler = import_module("cloudpickle").Pickler
    except ImportError:
        return pickled or pickle.dumps(obj)
    return _dump(cloud_pickler, obj)


def unpack(data: bytes) -> Any:
    """Return the object again; only for bytes that this program has packed."""
    return pickle.loads(data)  # noqa: S301


def _dump(kind: Any, obj: Any) -> bytes:
    class Pickler(kind):  # type: ignore[misc]
        def reducer_override(self, candidate: Any) -> Any:
            # a class or function of such a module is rebuilt by its qualified name
            if isinstance(candidate, (type, FunctionType)):
                rebuilder = getattr(sys.modules.get(candidate.__module__), REBUILDER, None)
                if rebuilder is not None:
                    return rebuilder, (candidate.__qualname__,)
            return super().reducer_override(candidate) if hasattr(super(), "reducer_override") else NotImplemented

    buffer = io.BytesIO()
    Pickler(buffer, pickle.HIGHEST_PROTOCOL).dump(obj)
    return buffer.getvalue()


class Status(StrEnum):
    """What became of a job: done, raised an error, longer than its limit, out of memory, or its process died."""

    OK = "ok"
    FAILED = "failed"
    TIMED_OUT = "timed out"
    OUT_OF_MEMORY = "out of memory"
    DIED = "died"


FAILURES = tuple(status.value for status in Status if status is not Status.OK)  # another attempt may succeed


@dataclass(frozen=True)
class Limits:
    """The most that one job may take: ``seconds``, and ``memory`` (GB) of the process that runs it; None: no limit.

    Only Linux limits the memory.
    """

    seconds: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("seconds", self.seconds), ("memory", self.memory)):
            if value is not None and not value > 0:
                raise InputError(f"the limit of a job, {name} = {value}, must be positive.")


@dataclass(frozen=True)
class JobOptions:
    """Where jobs run, on an ``executor`` (None: in this process), and the ``limits`` of each."""

    executor: Executor | None = None
    limits: Limits | None = None


@dataclass(frozen=True)
class JobResult(Generic[J, T]):
    """The result of a job: its ``value`` where ``status`` is OK, else None and the ``reason``; ``seconds`` it took."""

    job: J
    value: T | None
    status: Status = Status.OK
    reason: str = ""
    seconds: float = 0.0


class JobOutcome(NamedTuple):
    """What became of a job, on its way from the worker: its ``value`` pickled."""

    status: Status
    seconds: float
    value: bytes = b""
    reason: str = ""


def attempt(function: Callable[[Any], Any], job: bytes) -> JobOutcome:
    """Run ``function`` on a pickled job and return the outcome."""
    value, status, reason, seconds = run_call(lambda: pack(function(unpack(job))))
    return JobOutcome(status, seconds, value or b"", reason)


def run_call(call: Callable[[], T]) -> tuple[T | None, Status, str, float]:
    """Return the value of a call (None where it raises), its status, the reason, and the seconds it took."""
    value, status, reason, began = None, Status.OK, "", time.perf_counter()
    try:
        value = call()
    except KeyboardInterrupt:
        raise
    # the job is user code: no error of it may end the worker
    except BaseException as error:  # also of a library in Rust that panics, or a job that calls sys.exit
        status, reason = _status_of(error)
    return value, status, reason, time.perf_counter() - began


def _status_of(error: BaseException) -> tuple[Status, str]:
    """Return the status and the reason that an exception gives a job."""
    status = Status.OUT_OF_MEMORY if isinstance(error, MemoryError) else Status.FAILED
    try:
        return status, f"{type(error).__name__}: {error}"
    except Exception:  # of its own text
        return status, type(error).__name__


class WorkOrder(NamedTuple):
    """Jobs for a worker process; ``function`` is None where it is that of the order before."""

    function: bytes | None
    memory: float | None
    jobs: Sequence[bytes]


def serve(connection: Connection, preload: Iterable[str]) -> None:
    """Run orders until the other end is closed; this process ends with its parent, even in the middle of a job.

    The answer to an order is a text, empty or why it cannot be run, then the outcome of each job.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # for who started us, and ends us
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")  # where memory runs out, Linux ends this one first
    _end_with_parent()
    if not ONE_THREAD.items() <= os.environ.items():  # forked by a server that was there before
        os.environ.update(ONE_THREAD)
        limit_threads()
    for name in preload:
        with suppress(Exception):  # a job that needs it will say why
            import_module(name)
    function: Any = None
    with suppress(EOFError, OSError):
        while True:
            order = WorkOrder(*connection.recv())
            try:
                function = function if order.function is None else unpack(order.function)
                refusal = _memory_complaint(order)
            except BaseException as error:
                refusal = f"a worker cannot load the function of the jobs: {type(error).__name__}: {error}"
            connection.send(refusal)
            for job in () if refusal else order.jobs:
                with _limit_memory(order.memory):
                    outcome = attempt(function, job)
                connection.send(tuple(outcome))
                if outcome.status is Status.OUT_OF_MEMORY:  # what is left of it may be in the way of the next
                    os._exit(0)
            sys.stdout.flush()  # what jobs have printed


def _end_with_parent() -> None:
    """Let this process end when its parent does."""
    if (parent := parent_process()) is None:
        return
    if sys.platform == "linux":
        import fcntl

        # a job may never let a thread of Python run: Linux ends this process by SIGIO when the pipe is closed
        fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, fcntl.fcntl(parent.sentinel, fcntl.F_GETFL) | os.O_ASYNC)
    Thread(target=_exit_after, args=(parent,), daemon=True).start()


def _exit_after(parent: BaseProcess) -> NoReturn:
    parent.join()
    os._exit(1)


@cache
def limit_threads() -> None:
    """Let BLAS compute by one thread in this process: others use the other cores."""
    import scipy.linalg  # noqa: F401  # SciPy's own BLAS must be loaded to be found
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


def _memory_complaint(order: WorkOrder) -> str:
    """Return a complaint where this process already takes the memory of a job, else an empty text.

    It is looked at once for each function.
    """
    if order.function is None or order.memory is None:
        return ""
    try:
        with _limit_memory(order.memory):
            bytes(MIN_JOB_BYTES)
    except MemoryError:
        return f"a worker takes more than the limit of {order.memory:g} GB before it runs any job."
    return ""


@contextmanager
def _limit_memory(memory: float | None) -> Iterator[None]:
    """Limit the memory (GB) of this process, where the system can."""
    if memory is None or sys.platform == "win32":
        yield
        return
    import resource

    previous_limit, hard_limit = resource.getrlimit(resource.RLIMIT_DATA)
    limit = int(memory * 1e9) if hard_limit == resource.RLIM_INFINITY else min(int(memory * 1e9), hard_limit)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard_limit))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (previous_limit, hard_limit))
