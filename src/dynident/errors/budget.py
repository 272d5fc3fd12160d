"""The budget of memory of a run: what one file may take when it is read, and what one fit may hold at once."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from dynident.errors.errors import ConfigError

__all__ = ["GIGABYTE", "MEMORY", "amount", "budgeted", "give", "memory"]

MEMORY = "DYNIDENT_MEMORY"  # the environment variable with the budget, in GB
USUAL = 4.0  # GB
GIGABYTE = 10**9
_GIVEN: ContextVar[float | None] = ContextVar("memory", default=None)


@contextmanager
def budgeted() -> Iterator[None]:
    """Keep the budget that is given inside from what follows."""
    token = _GIVEN.set(_GIVEN.get())
    try:
        yield
    finally:
        _GIVEN.reset(token)


def give(gigabytes: float) -> None:
    """Set the budget, in GB."""
    _GIVEN.set(gigabytes)


def memory() -> int:
    """Return the bytes of the budget; ConfigError where the environment has no number."""
    given, own = os.environ.get(MEMORY) or USUAL, _GIVEN.get()
    try:
        found = float(given if own is None else own)
        if not 0 < found < float("inf"):
            raise ValueError
    except ValueError as error:
        raise ConfigError(f"{MEMORY} is {given!r}; give a positive number of GB.") from error
    return int(found * GIGABYTE)


def amount(count: float) -> str:
    """Return so many bytes in words."""
    return f"{count / GIGABYTE:.3g} GB" if count >= GIGABYTE / 10 else f"{count / 1e6:.3g} MB"
