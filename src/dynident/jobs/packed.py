"""Objects as bytes, on their way between processes of this program."""

from __future__ import annotations

import pickle
from importlib import import_module
from typing import Any

__all__ = ["packed", "unpacked"]


def packed(thing: Any) -> bytes:
    """Return a pickle; that of what only this process knows, such as a lambda, has its code where cloudpickle is."""
    try:
        found = pickle.dumps(thing, pickle.HIGHEST_PROTOCOL)
        if b"__main__" not in found:
            return found
    except (pickle.PicklingError, AttributeError, TypeError):
        found = b""
    try:
        whole: bytes = import_module("cloudpickle").dumps(thing)
    except ImportError:
        return found or pickle.dumps(thing)
    return whole


def unpacked(data: bytes) -> Any:
    """Return the object again; only of what this program has packed."""
    return pickle.loads(data)  # noqa: S301
