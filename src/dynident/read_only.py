"""The arrays of recordings: read-only, checked once, and copied only where somebody could still write to them."""

from __future__ import annotations

from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import InputError

__all__ = ["frozen", "kept", "matrix", "owned", "times"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_FINITE: WeakValueDictionary[int, Array] = WeakValueDictionary()  # arrays whose values are known to be, by id


def frozen(value: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a read-only contiguous array; copied only where the caller could still write to it."""
    try:
        array = np.ascontiguousarray(value, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise InputError(f"numbers are expected: {error}.") from error
    if array is value or array.base is not None:
        if array.flags.owndata and not array.flags.writeable:
            return array
        array = array.copy()
    array.flags.writeable = False
    return array


def matrix(value: ArrayLike, rows: int, columns: int, name: str, source: str) -> Array:
    """Return a channel as a read-only array (rows, columns) of finite numbers; InputError where it is not one."""
    array = frozen(value)
    if array.shape != (rows, columns):
        raise InputError(
            f"{source}: {name} has shape {array.shape}, expected ({rows}, {columns}): "
            "one row per time stamp and one column per joint."
        )
    if _FINITE.get(id(array)) is not array and not np.isfinite(array).all():
        bad = np.argwhere(~np.isfinite(array))
        i, j = bad[0]
        raise InputError(
            f"{source}: {name}[{i}, {j}] is {array[i, j]} ({len(bad)} non-finite values in all). "
            "Remove or interpolate these samples in the file, or leave them out with a window."
        )
    _FINITE[id(array)] = array
    return array


def owned(array: Array) -> Array:
    """Return an array that was made here, read-only, so that it need not be copied."""
    array.flags.writeable = False
    return array


def kept(value: Mask | None, shape: tuple[int, ...], source: str, name: str = "keep") -> Mask | None:
    """Return which values are used as a read-only array of a shape; InputError where it has another."""
    if value is None:
        return None
    keep = frozen(value, np.bool_)
    if keep.shape != shape:
        raise InputError(f"{source}: {name} has shape {keep.shape}, expected {shape}.")
    return keep


def times(value: ArrayLike, source: str) -> Array:
    """Return time stamps as a read-only array (N), increasing and finite; InputError where they are not."""
    t = frozen(value)
    if t.ndim != 1 or len(t) < 2:
        raise InputError(f"{source}: needs at least 2 time stamps in one column, got shape {t.shape}.")
    if not np.isfinite(t).all():
        i = int(np.flatnonzero(~np.isfinite(t))[0])
        raise InputError(f"{source}: time stamp {i} is {t[i]}; remove the rows without a valid time.")
    steps = np.diff(t)
    if (steps <= 0).any():
        i = int(np.flatnonzero(steps <= 0)[0])
        what = "repeats" if steps[i] == 0 else "runs backwards after"
        raise InputError(
            f"{source}: time stamp {i + 1} ({t[i + 1]!r} s) {what} stamp {i} ({t[i]!r} s); "
            "sort the rows by time and drop repeated stamps (the first of each is usually right)."
        )
    return t
