"""Objects as bytes, on their way between processes of this program."""

from __future__ import annotations

import io
import pickle
import sys
from importlib import import_module
from types import FunctionType
from typing import Any

__all__ = ["AGAIN", "packed", "unpacked"]

AGAIN = "__dynident_again__"  # of a module that no other process can import by its name: what gets a name of it there


def packed(thing: Any) -> bytes:
    """Return a pickle; that of what only this process knows, such as a lambda, has its code where cloudpickle is.

    What is of a module with the attribute ``AGAIN``, a callable that can be pickled, is what this returns for its name.
    """
    try:
        found = _dumped(pickle.Pickler, thing)
        if b"__main__" not in found:
            return found
    except (pickle.PicklingError, AttributeError, TypeError):
        found = b""
    try:
        other = import_module("cloudpickle").Pickler
    except ImportError:
        return found or pickle.dumps(thing)
    return _dumped(other, thing)


def unpacked(data: bytes) -> Any:
    """Return the object again; only of what this program has packed."""
    return pickle.loads(data)  # noqa: S301


def _dumped(kind: Any, thing: Any) -> bytes:
    class Pickler(kind):  # type: ignore[misc]
        def reducer_override(self, one: Any) -> Any:
            if isinstance(one, (type, FunctionType)):
                again = getattr(sys.modules.get(one.__module__), AGAIN, None)
                if again is not None:
                    return again, (one.__qualname__,)
            return super().reducer_override(one) if hasattr(super(), "reducer_override") else NotImplemented

    buffer = io.BytesIO()
    Pickler(buffer, pickle.HIGHEST_PROTOCOL).dump(thing)
    return buffer.getvalue()
