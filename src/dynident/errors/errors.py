"""The errors dynident raises on purpose: each message names the wrong value, where it is, and how to correct it."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

__all__ = ["ConfigError", "DynidentError", "InputError", "MissingInputError", "ModelError", "choices"]


class DynidentError(Exception):
    """Base of all errors meant for the user; the command prints its message without a traceback."""


class InputError(DynidentError):
    """Measured data that cannot be used: a file, a column, a time stamp or a value."""


class MissingInputError(InputError):
    """A part needs something that the log does not have: a controller, a period, a second recording."""


class ConfigError(DynidentError):
    """A setting that is unknown, of the wrong type or out of range."""


class ModelError(DynidentError):
    """A robot model that cannot be built or evaluated."""


def choices(wrong: object, known: Iterable[str]) -> str:
    """Return a sentence with the alternatives to a wrong name, the nearest first: ``did you mean 'x'? Known: ...``."""
    names = [str(name) for name in known]
    if not names:
        return "there is none to choose from."
    near = get_close_matches(str(wrong), names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    shown = ", ".join(repr(name) for name in names[:20]) + (", ..." if len(names) > 20 else "")
    return f"{hint}Known: {shown}."
