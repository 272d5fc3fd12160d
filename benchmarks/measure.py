"""Measure work in processes of their own, one for each way in which it is done, in turn and with one BLAS thread.

A work is a function of a file beside this one. Of who does it, "dynident" or the name of a peer, and its own arguments
it prepares the data and returns what is to be measured, a function without arguments; where that returns a dictionary,
it has measured itself: these fields of a Figure. FileNotFoundError or ImportError say that data or a peer are not here.

Only the standard library is imported here: a process may inherit the peak memory of the one that starts it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

FOLDER = Path(__file__).parent
OWN = {"with": {}, "without": {"DYNIDENT_KERNEL": "off"}}  # ways of dynident with the environment that asks for them
ALL = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1") | {"PYTHONWARNINGS": "ignore"}
SHORT = 0.05  # s, for which a short work is repeated to be measured
LONG = 2.0  # s, from which the first time counts
ROUNDS = 15  # at most
FAILED = "failed: its errors are above"
GIB = 2**20 if sys.platform != "darwin" else 2**30  # of ru_maxrss


@dataclass(frozen=True)
class Work:
    """A work: ``name`` of ``file``, called with ``arguments``; done by dynident in some ``ways``, and by ``peers``.

    Once each of them has done it, they repeat it in turn for about ``seconds``.
    """

    file: str
    name: str
    arguments: tuple[str | float, ...] = ()
    peers: tuple[str, ...] = ()
    ways: tuple[str, ...] = tuple(OWN)
    seconds: float = 4.0

    @property
    def key(self) -> str:
        """What tells it from others."""
        return ":".join([self.file, self.name, *map(str, self.arguments)])


@dataclass(frozen=True)
class Figure:
    """The best of all rounds: seconds of CPU (own and of processes that were started) and of the clock; and the largest
    peak of memory in GiB, with how much of it is above the prepared data."""

    cpu: float
    wall: float
    peak: float
    rise: float

    def best(self, other: Figure | str) -> Figure | str:
        """Return the best of both; a failure is one of all."""
        if isinstance(other, str):
            return other
        faster = min(self.cpu, other.cpu), min(self.wall, other.wall)
        return Figure(*faster, max(self.peak, other.peak), max(self.rise, other.rise))


def measured(work: Work) -> dict[str, Figure | str]:
    """Return by way and peer what a work costs, or why this is not known here."""
    result: dict[str, Figure | str] = {}
    with ExitStack() as stack:
        workers: dict[str, Worker] = {}
        for way in (*work.ways, *work.peers):
            worker = stack.enter_context(started(work, way))
            result[way] = worker.answer()
            workers[way] = worker
        began = time.monotonic()
        for _ in range(ROUNDS - 1):
            if time.monotonic() - began > work.seconds:
                break
            for way, worker in workers.items():
                case = result[way]
                if isinstance(case, Figure) and case.wall < work.seconds:  # else once is enough
                    result[way] = case.best(worker.again())
    return result


@dataclass(frozen=True)
class Worker:
    """A process that does one work in one way, each time that a line is sent to it."""

    process: subprocess.Popen[str]

    def again(self) -> Figure | str:
        """Let it do its work once more."""
        try:
            self._pipe(self.process.stdin).write("\n")
            self._pipe(self.process.stdin).flush()
        except BrokenPipeError:
            return "the process has ended"
        return self.answer()

    def answer(self) -> Figure | str:
        """Wait for what it says."""
        line = self._pipe(self.process.stdout).readline()
        said = json.loads(line) if line else FAILED
        return said if isinstance(said, str) else Figure(**said)

    def _pipe(self, pipe: IO[str] | None) -> IO[str]:
        assert pipe is not None
        return pipe


@contextmanager
def started(work: Work, way: str) -> Iterator[Worker]:
    """Give a worker, which ends with the block."""
    environment = {name: value for name, value in os.environ.items() if name != "DYNIDENT_KERNEL"}
    command = [sys.executable, __file__, work.file, work.name, json.dumps(work.arguments), way]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment | ALL | OWN.get(way, {})
    ) as process:
        try:
            yield Worker(process)
        finally:
            process.kill()


def serve(file: str, name: str, arguments: str, way: str) -> None:
    """Do one work in one way: once to begin with, then each time that a line comes; answer with what it cost."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a peer prints is no answer
    sys.path.insert(0, str(FOLDER))

    def say(answer: object) -> None:
        print(json.dumps(answer), file=out, flush=True)

    try:
        prepare: Callable[..., Callable[[], object]] = getattr(__import__(file), name)
        call = prepare("dynident" if way in OWN else way, *json.loads(arguments))
        first = once(call, 1)
    except (FileNotFoundError, ImportError) as why:
        say(str(why))
        return
    if first["wall"] < LONG:  # it has imported what it needs, too
        first = once(call, 1)
    number = max(1, int(SHORT / first["wall"]))
    say(first if number == 1 else once(call, number))
    for _ in sys.stdin:
        say(once(call, number))


def once(call: Callable[[], object], number: int) -> dict[str, float]:
    """Do a work so many times; return the fields of the Figure of one of them."""
    with suppress(OSError):  # on Linux; elsewhere the peak is that of the whole process
        Path("/proc/self/clear_refs").write_text("5")
    before, began, spent, said = peak(), time.perf_counter(), cpu(), None
    for _ in range(number):
        said = call()
    used, wall = (cpu() - spent) / number, (time.perf_counter() - began) / number
    most = peak()
    result = {"cpu": used, "wall": wall, "peak": most, "rise": max(0.0, most - before)}
    return result | said if isinstance(said, dict) else result


def cpu() -> float:
    """Return the seconds of CPU of this process and of those that it has waited for."""
    import resource

    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def peak() -> float:
    """Return the largest memory of this process, or of one that it has waited for, in GiB."""
    import resource

    own, children = (
        resource.getrusage(who).ru_maxrss / GIB for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    status = Path("/proc/self/status")  # of Linux: without what the process that started this one had used
    if status.exists():
        own = next(int(line.split()[1]) / 2**20 for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return max(own, children)


if __name__ == "__main__":
    serve(*sys.argv[1:])
