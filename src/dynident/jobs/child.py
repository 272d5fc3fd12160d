"""What runs in a worker process: jobs, one by one; or the server that such processes are forked from."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any, NamedTuple, NoReturn

from dynident.jobs.attempt import attempt
from dynident.jobs.job import Status
from dynident.jobs.packed import unpacked

__all__ = ["NUMBER", "Order", "fork_server", "serve", "serve_at"]

NUMBER = 8  # bytes of a number between a server and the process that started it
PATIENCE = 1.0  # s between looks whether that is still there
PDEATHSIG = 1  # of prctl(2): the signal that comes when the server dies
SPARE = 16_000_000  # bytes that a job needs at least


class Order(NamedTuple):
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
    """Run orders until the other end is closed or ``parent`` gone, which ends this process, whatever it is at.

    The answer to an order is a text, empty or why it cannot be run, then what became of each job.
    """
    for number in (signal.SIGINT, signal.SIGTERM):  # for who started us, and ends us
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")  # where memory runs out, Linux ends this one first
    orders: SimpleQueue[bytes] = SimpleQueue()
    Thread(target=_read, args=(connection, orders, parent), daemon=True).start()
    function: Any = None
    while True:
        order = Order(*unpacked(orders.get()))
        try:
            function = function if order.function is None else unpacked(order.function)
            refused = _too_large(order)
        except BaseException as error:
            refused = f"a worker cannot load the function of the jobs: {type(error).__name__}: {error}"
        connection.send(refused)
        if refused:
            continue
        for job in order.jobs:
            with _limited(order.memory):
                ended = attempt(function, job)
            connection.send(tuple(ended))
            if ended.status is Status.OUT_OF_MEMORY:  # what is left of it may be in the way of the next
                os._exit(0)
        sys.stdout.flush()  # what jobs have printed


def _too_large(order: Order) -> str:
    """Return that this process takes the memory of a job already, where that is so; asked once a function."""
    if order.function is None or order.memory is None:
        return ""
    try:
        with _limited(order.memory):
            bytes(SPARE)
    except MemoryError:
        return f"a worker takes more than the limit of {order.memory:g} GB before it runs any job."
    return ""


def _read(connection: Connection, orders: SimpleQueue[bytes], parent: int) -> NoReturn:
    try:
        while os.getppid() == parent or sys.platform == "win32":
            if connection.poll(PATIENCE):
                orders.put(connection.recv_bytes())
    finally:
        os._exit(1)


@contextmanager
def _limited(memory: float | None) -> Iterator[None]:
    """Limit the memory (GB) of this process, where the system can."""
    if memory is None or sys.platform == "win32":
        yield
        return
    import resource

    before, most = resource.getrlimit(resource.RLIMIT_DATA)
    least = int(memory * 1e9) if most == resource.RLIM_INFINITY else min(int(memory * 1e9), most)
    resource.setrlimit(resource.RLIMIT_DATA, (least, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, most))


def fork_server(descriptor: int, preload: Sequence[str]) -> NoReturn:
    """Import what workers need, then fork them, and end them, as asked; all of them when who asks is gone.

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
    control.settimeout(PATIENCE)
    try:
        while os.getppid() == parent:  # another process may have inherited the other end
            with suppress(TimeoutError):
                _obey(control, children)
    except (EOFError, OSError):  # the other end is closed
        pass
    finally:
        for one in children:
            _end(one)
        os._exit(0)


def _obey(control: socket.socket, children: set[int]) -> None:
    request, descriptors, _, _ = socket.recv_fds(control, NUMBER, 1)
    if not request:
        raise EOFError
    if child := int.from_bytes(request, "little"):
        children.discard(child)
        answer = _end(child)
    else:
        answer = _fork(control, descriptors[0])
        children.add(answer)
    control.sendall(answer.to_bytes(NUMBER, "little", signed=True))


def _fork(control: socket.socket, descriptor: int) -> int:
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
