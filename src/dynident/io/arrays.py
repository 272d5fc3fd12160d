"""Named arrays of a file to columns: only those that are needed are read, each within the budget of memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import memory
from dynident.io.opener import afford

__all__ = ["Columns", "Found", "StoredArray", "columns_of", "held"]

Array = NDArray[np.float64]
_SHOWN = 1000  # columns of one array that are listed one by one where they are not read
_LONG = 20  # times the other side of an array: a side that long is the time, where no column says so


@dataclass(frozen=True)
class StoredArray:
    """An array that is still in its file: shape, type, the function that reads it, and what that takes besides."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[], NDArray[Any]]
    extra: int = 0  # bytes

    @property
    def size(self) -> int:
        """The number of elements."""
        return math.prod(self.shape)

    @property
    def cost(self) -> int:
        """The memory (bytes) that reading takes: the array as it is stored, and as float64."""
        return self.size * (self.dtype.itemsize + 8) + self.extra


Found = StoredArray | str  # a text describes what is no array of numbers


@dataclass
class Columns:
    """What a file holds, by name: columns and scalars as float64, faults, and the columns that were not needed;
    ``guesses``: the arrays whose time was taken to run along their rows."""

    columns: dict[str, Array] = field(default_factory=dict)
    constants: dict[str, float] = field(default_factory=dict)
    faults: dict[str, str] = field(default_factory=dict)
    unread: list[str] = field(default_factory=list)
    guesses: list[str] = field(default_factory=list)


def held(array: NDArray[Any]) -> StoredArray:
    """Return an array that is in memory already."""
    return StoredArray(array.shape, array.dtype, lambda: array)


def columns_of(items: Mapping[str, Found], needed: Collection[str] | None, source: str, taken: int = 0) -> Columns:
    """Read the arrays; where ``needed`` is given, only those with such columns.

    Time runs down the rows, or along them where the length of other columns, or else a side that is far longer, says
    so, which is a guess to report. ``taken`` is the memory (bytes) in use already. An array that is needed by name and
    beyond the budget is an InputError; where all are wanted, it is a fault of its columns.
    """
    lengths = {
        one.size for one in items.values() if not isinstance(one, str) and max(one.shape, default=0) == one.size > 1
    }
    found = Columns()
    for name, one in items.items():
        if isinstance(one, str) or one.dtype.kind not in "biuf" or one.size == 0:
            found.faults[name] = f"holds {_content(one)}, not an array of numbers."
        elif not (table := _table(one.shape, lengths)):
            words = f"has the shape {one.shape}; time must run down the rows of a 2-D array: transpose it."
            found.faults[name] = words
        elif not _wanted(name, one, needed):
            found.unread += _names(name, min(table[1], _SHOWN))
        elif needed is None and taken + one.cost > memory():
            words = f"would take {one.cost / 1e9:.3g} GB of memory, more than a file may; raise this by --memory."
            found.faults |= dict.fromkeys([*_names(name, min(table[1], _SHOWN)), name], words)
        else:
            afford(taken := taken + one.cost, f"{source}: to read {name!r}, {one.shape}, would take")
            values = one.read()
            if table == _sides(one.shape)[::-1] and table[0] != table[1]:
                found.guesses.append(_guess(name, one.shape, *table, known=table[0] in lengths))
            if one.size == 1:
                found.constants[name] = float(values.item())
            else:
                found.columns |= zip(_names(name, table[1]), _split(values, *table), strict=True)
    return found


def _wanted(name: str, one: StoredArray, needed: Collection[str] | None) -> bool:
    return needed is None or one.size == 1 or any(part == name or part.startswith(f"{name}[") for part in needed)


def _table(shape: tuple[int, ...], lengths: Collection[int]) -> tuple[int, int] | None:
    """Return rows and columns: time runs down the rows of an array, or along them, as ``lengths`` of others tell, or
    a side that is far longer where they do not; None where it is not clear. Sides of one are left out."""
    if max(shape, default=1) == (size := math.prod(shape)):
        return size, 1
    if len(sides := _sides(shape)) != 2:
        return None
    rows, columns = sides
    down, along = rows in lengths, columns in lengths
    unsaid = (along and down) or not lengths
    if (along and not down) or (unsaid and columns >= _LONG * rows):
        return columns, rows
    return (rows, columns) if rows >= columns else None


def _sides(shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(n for n in shape if n != 1)


def _guess(name: str, shape: tuple[int, ...], rows: int, columns: int, *, known: bool) -> str:
    why = f"as other columns have {rows} values" if known else "its longer side"
    return f"{name!r} has the shape {shape}: it is read as {rows} rows of {columns} columns, {why}."


def _names(name: str, columns: int) -> list[str]:
    return [name] if columns == 1 else [f"{name}[{k}]" for k in range(columns)]


def _split(array: NDArray[Any], rows: int, columns: int) -> list[Array]:
    if columns == 1:
        return [_float(array.reshape(-1))]
    array = array.reshape(_sides(array.shape))
    array = array if array.shape == (rows, columns) else array.T
    return [_float(array[:, k]) for k in range(columns)]


def _float(array: NDArray[Any]) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):  # extended precision may exceed float64: then inf
        return np.array(array, dtype=np.float64)


def _content(one: Found) -> str:
    return one if isinstance(one, str) else f"{one.dtype} values of shape {one.shape}"
