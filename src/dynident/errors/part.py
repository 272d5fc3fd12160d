"""Calls a part that may be of another package or a file of the user: what goes wrong in it is said in a sentence."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any, TypeVar

from dynident.errors.errors import ConfigError, DynidentError

__all__ = ["called"]

T = TypeVar("T")


def called(part: Callable[[Any], object], given: object, result: type[T]) -> T:
    """Return what a part makes of ``given``; ConfigError where it fails, or where that is no ``result``.

    Errors of the parts of this library are left as they are, and so is a lack of memory.
    """
    name = getattr(part, "__name__", type(part).__name__)
    try:
        made = part(given)
    except (DynidentError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        if str(getattr(part, "__module__", "")).startswith("dynident."):
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        words = f"{name} failed at {last.filename}:{last.lineno}: {type(error).__name__}: {error}"
        raise ConfigError(words) from error
    if not isinstance(made, result):
        raise ConfigError(f"{name} returned a {type(made).__name__}; it must return a {result.__name__}.")
    return made
