"""One attempt at a job, where its worker is: whatever it raises is a result."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from dynident.jobs.job import Status
from dynident.jobs.packed import packed, unpacked

__all__ = ["Ended", "attempt", "tried"]

T = TypeVar("T")


class Ended(NamedTuple):
    """What became of a job, on its way from the worker: its ``value`` pickled."""

    status: Status
    seconds: float
    value: bytes = b""
    reason: str = ""


def attempt(function: Callable[[Any], Any], job: bytes) -> Ended:
    """Return what ``function`` makes of a pickled job."""
    value, status, reason, seconds = tried(lambda: packed(function(unpacked(job))))
    return Ended(status, seconds, value or b"", reason)


def tried(call: Callable[[], T]) -> tuple[T | None, Status, str, float]:
    """Return the value of a call, None where it raises, what became of it, the reason, and the seconds it took."""
    value, status, reason, began = None, Status.OK, "", time.perf_counter()
    try:
        value = call()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # also of a library in Rust that panics, or a job that calls sys.exit
        status, reason = _status_of(error)
    return value, status, reason, time.perf_counter() - began


def _status_of(error: BaseException) -> tuple[Status, str]:
    """Return what an exception makes of a job, and how it is said."""
    status = Status.OUT_OF_MEMORY if isinstance(error, MemoryError) else Status.FAILED
    try:
        return status, f"{type(error).__name__}: {error}"
    except Exception:  # of its own text
        return status, type(error).__name__
