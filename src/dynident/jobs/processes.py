"""Starts worker processes, which end with this one, and to which no signal of a terminal comes.

Those of ``multiprocessing`` would import the user's script again, may not be started by a worker of Dask (whose nanny
makes it a daemon) and can get a Ctrl-C before they ignore it; these are started from any thread, none of which is so.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from threading import Lock
from typing import Any, Protocol

from dynident.errors import InputError
from dynident.jobs.child import NUMBER

__all__ = ["ONE_THREAD", "Child", "ForkServer", "Start", "Starter", "starter"]

ONE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "POLARS_MAX_THREADS"), "1"
)  # before NumPy is loaded
TRIM = "MALLOC_TRIM_THRESHOLD_"  # a nanny of Dask sets it, and giving memory back each time costs a fit 40 % more CPU
GRACE = 2.0  # s for a server to end its workers


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
    return ForkServer(preload) if sys.platform == "linux" else Start()


def _python(call: str, **how: Any) -> subprocess.Popen[bytes]:
    """Start Python to call a function of ``child``."""
    code = f"import sys; sys.path[:] = {list(map(str, sys.path))}; from dynident.jobs import child; child.{call}"
    environment = {name: value for name, value in os.environ.items() if name != TRIM} | ONE_THREAD
    words = [sys.executable, "-c", code]
    try:
        return subprocess.Popen(words, stdin=subprocess.DEVNULL, env=environment, **how)  # noqa: S603 -- of our own
    except OSError as error:
        raise InputError(f"no worker process can be started: {error}.") from error


class Start:
    """Starts each worker anew, which takes as long as its imports, on any system."""

    def __init__(self) -> None:
        self._processes: set[subprocess.Popen[bytes]] = set()

    def start(self) -> Child:
        """Start one."""
        mine, other = Pipe()
        with other:
            handle = other.fileno()
            if sys.platform == "win32":
                os.set_handle_inheritable(handle, True)
                new: Any = {
                    "startupinfo": subprocess.STARTUPINFO(lpAttributeList={"handle_list": [handle]}),
                    "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP,
                }
            else:
                new = {"pass_fds": (handle,), "start_new_session": True}
            process = _python(f"serve_at({handle}, {os.getpid()})", **new)
        self._processes.add(process)
        return Child(mine, partial(self._end, process))

    def _end(self, process: subprocess.Popen[bytes]) -> int:
        process.kill()
        self._processes.discard(process)
        return process.wait()

    def close(self) -> None:
        """End all."""
        for process in list(self._processes):
            self._end(process)


class ForkServer:
    """Forks workers from one process that has imported all, which takes some milliseconds each."""

    def __init__(self, preload: Iterable[str]) -> None:
        self._preload = tuple(preload)
        self._lock, self._closed = Lock(), False
        self._launch()

    def _launch(self) -> None:
        self._control, other = socket.socketpair()
        with other:
            call = f"fork_server({other.fileno()}, {self._preload})"
            self._process = _python(call, pass_fds=(other.fileno(),), start_new_session=True)
        self._used = False

    def start(self) -> Child:
        """Fork one."""
        mine, other = Pipe()
        with other, self._lock:
            try:
                number = self._forked(other)
            except OSError as error:
                mine.close()
                raise InputError(f"no worker process can be started: {error}.") from error
            self._used = True
        return Child(mine, partial(self._end, number))

    def _forked(self, other: Connection) -> int:
        try:
            return self._ask(0, [other.fileno()])
        except OSError:
            if self._closed:
                raise
            self._stop()  # it was killed; the workers that it had go on
            self._launch()
            return self._ask(0, [other.fileno()])

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
        socket.send_fds(self._control, [number.to_bytes(NUMBER, "little")], list(descriptors))
        if not (answer := self._control.recv(NUMBER)):
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
            self._process.wait(GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
