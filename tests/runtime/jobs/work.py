"""Functions of jobs, in a module that workers can import."""

import itertools
import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from dynident.runtime import memory_budget
from dynident.runtime.jobs import JobResult

HANGS = 600.0  # s: nothing takes as long, even on a busy machine


@dataclass(frozen=True)
class Noise:
    """Sums noise of which the job is the seed, by a matrix product that rounds."""

    matrix: Any

    def __call__(self, seed: int) -> float:
        return float(np.sum(self.matrix @ np.random.default_rng(seed).standard_normal(len(self.matrix))))


def budget(_: int) -> int:
    """The bytes of the budget where the job runs."""
    return memory_budget()


@dataclass(frozen=True)
class Trouble:
    """Notes each call in a folder; the job ``(name, number)`` says what goes wrong."""

    folder: Path

    def __call__(self, job: tuple[str, int]) -> int:
        name, number = job
        with (self.folder / f"{number}").open("a") as file:
            file.write(f"{os.getpid()}\n")
        return getattr(self, name)(number)  # type: ignore[no-any-return]

    def calls(self, number: int) -> int:
        return len((self.folder / f"{number}").read_text().splitlines())

    def silent(self, number: int) -> int:
        raise _SilentError

    def fine(self, number: int) -> int:
        return number**2

    def raises(self, number: int) -> int:
        raise ValueError(f"no {number}")

    def leaves(self, number: int) -> int:
        raise SystemExit(number)

    def hangs(self, number: int) -> int:
        time.sleep(HANGS)
        return number

    def eats(self, number: int) -> int:
        return len([bytearray(10_000_000) for _ in range(1000)])

    def ends(self, number: int) -> int:
        os._exit(7)

    def crashes(self, number: int) -> int:
        os.kill(os.getpid(), signal.SIGKILL)
        return number

    def crashes_once(self, number: int) -> int:
        if self.calls(number) == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    def unpicklable(self, number: int) -> Any:
        return _Odd()


class _SilentError(Exception):
    def __str__(self) -> str:
        raise ValueError("no words")


class _Odd(int):
    def __reduce__(self) -> Any:
        raise TypeError("stays here")


def process(_: object) -> int:
    return os.getpid()


def slow_process(_: object) -> int:
    time.sleep(0.1)  # so that each worker has its share, however late it starts
    return os.getpid()


def parent(_: object) -> int:
    return os.getppid()


def threads(_: object) -> tuple[str | None, str | None]:
    return os.environ.get("OMP_NUM_THREADS"), os.environ.get("OPENBLAS_NUM_THREADS")


def blas_threads(_: object) -> set[int]:
    return {x["num_threads"] for x in threadpool_info() if x["user_api"] == "blas"}


def chance_to_be_killed(_: object) -> int:
    return int(Path("/proc/self/oom_score_adj").read_text())


def sleeps(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def by_job(done: list[JobResult[Any, Any]]) -> dict[Any, JobResult[Any, Any]]:
    """Each job once."""
    result = {x.job: x for x in done}
    assert len(result) == len(done)
    return result


def loaded(name: str) -> bool:
    return name in sys.modules


def told(_: object) -> None:
    """Says that it runs, and goes on."""
    os.write(2, b"a job\n")


def stuck(_: object) -> None:
    """Says that it runs, and never lets another thread of Python run."""
    told(_)
    sum(itertools.repeat(1))


def soon_stuck(number: int) -> None:
    """The first job ends, after the next has begun."""
    if number:
        stuck(number)
    told(number)
    time.sleep(0.5)


class Stranger:
    """Cannot be loaded in another process."""

    def __reduce__(self) -> Any:
        return _load, (os.getpid(),)

    def __call__(self, job: object) -> None:
        """Nothing."""


def _load(process: int) -> Stranger:
    if process != os.getpid():
        raise RuntimeError("not here")
    return Stranger()
