"""What becomes of a job, and what limits it."""

from __future__ import annotations

import ctypes
import gc
import io
import os
import pickle
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from types import FunctionType
from typing import Any, Generic, NamedTuple, NoReturn, TypeVar

from dynident.runtime.errors import InputError

# of a module that no other process can import by its name: what gets a name of it there
REBUILDER = "__dynident_again__"

J = TypeVar("J")
T = TypeVar("T")

NUMBER_BYTES = 8  # bytes of a number between a server and the process that started it
POLL_SECONDS = 1.0  # s between looks whether that is still there
PDEATHSIG = 1  # of prctl(2): the signal that comes when the server dies
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


def serve_at(handle: int, parent: int) -> NoReturn:
    """Serve the end of a pipe that this process was started with."""
    if sys.platform == "win32":
        from multiprocessing.connection import PipeConnection

        serve(PipeConnection(handle), parent)
    else:
        serve(Connection(handle), parent)


def serve(connection: Connection, parent: int) -> NoReturn:
    """Run orders until the other end is closed or ``parent`` is gone; either ends this process at once.

    The answer to an order is a text, empty or why it cannot be run, then the outcome of each job.
    """
    for number in (signal.SIGINT, signal.SIGTERM):  # for who started us, and ends us
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")  # where memory runs out, Linux ends this one first
    orders: SimpleQueue[bytes] = SimpleQueue()
    # a thread reads the orders, and ends this process when the parent is gone, even in the middle of a job
    Thread(target=_read_orders, args=(connection, orders, parent), daemon=True).start()
    function: Any = None
    while True:
        order = WorkOrder(*unpack(orders.get()))
        try:
            function = function if order.function is None else unpack(order.function)
            refusal = _memory_complaint(order)
        except BaseException as error:
            refusal = f"a worker cannot load the function of the jobs: {type(error).__name__}: {error}"
        connection.send(refusal)
        if refusal:
            continue
        for job in order.jobs:
            with _limit_memory(order.memory):
                ended = attempt(function, job)
            connection.send(tuple(ended))
            if ended.status is Status.OUT_OF_MEMORY:  # what is left of it may be in the way of the next
                os._exit(0)
        sys.stdout.flush()  # what jobs have printed


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


def _read_orders(connection: Connection, orders: SimpleQueue[bytes], parent: int) -> NoReturn:
    try:
        while os.getppid() == parent or sys.platform == "win32":
            if connection.poll(POLL_SECONDS):
                orders.put(connection.recv_bytes())
    finally:
        os._exit(1)


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


def fork_server(descriptor: int, preload: Sequence[str]) -> NoReturn:
    """Import what workers need, then fork and end workers on request, and all of them when the parent is gone.

    A request is a number: 0, with the descriptor of a connection, forks a worker and is answered by its id; an id
    kills that worker and is answered by its exit code. An id is free again only after that answer.
    """
    parent, children = os.getppid(), set[int]()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    control = socket.socket(fileno=descriptor)
    for name in preload:
        with suppress(Exception):  # a job that needs it will say why
            import_module(name)
    gc.freeze()  # what is imported stays shared
    control.settimeout(POLL_SECONDS)
    try:
        while os.getppid() == parent:  # another process may have inherited the other end
            with suppress(TimeoutError):
                _answer_request(control, children)
    except (EOFError, OSError):  # the other end is closed
        pass
    finally:
        for child in children:
            _end(child)
        os._exit(0)


def _answer_request(control: socket.socket, children: set[int]) -> None:
    request, descriptors, _, _ = socket.recv_fds(control, NUMBER_BYTES, 1)
    if not request:
        raise EOFError
    if child := int.from_bytes(request, "little"):
        children.discard(child)
        answer = _end(child)
    else:
        answer = _fork(control, descriptors[0])
        children.add(answer)
    control.sendall(answer.to_bytes(NUMBER_BYTES, "little", signed=True))


def _fork(control: socket.socket, descriptor: int) -> int:
    # in the worker: die with the server, and leave its control socket to it
    server = os.getpid()
    if child := os.fork():
        os.close(descriptor)
        return child
    try:
        ctypes.CDLL(None).prctl(PDEATHSIG, signal.SIGKILL)
        control.close()
        serve(Connection(descriptor), server)
    finally:
        os._exit(1)


def _end(child: int) -> int:
    os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
