"""What becomes of a job, and what limits it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

from dynident.errors import InputError

__all__ = ["Done", "Limits", "Status"]

J = TypeVar("J")
T = TypeVar("T")


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
class Done(Generic[J, T]):
    """A job that has ended: its ``value`` where ``status`` is OK, else None and the ``reason``; ``seconds`` it took."""

    job: J
    value: T | None
    status: Status = Status.OK
    reason: str = ""
    seconds: float = 0.0
