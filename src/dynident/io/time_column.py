"""The column of time stamps among those of a recording, and its unit: from its name, or from its values."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.io.columns import ColumnFamily
from dynident.io.fields import UNITS
from dynident.io.match import finite, increases
from dynident.io.tables import DataTable

__all__ = ["TimeColumn", "has_gaps", "time_column"]

Array = NDArray[np.float64]

_FASTEST, _SLOWEST = 5e-5, 0.3  # s: sampling steps that are taken for granted
_FEW, _EVEN = 30, 0.1  # samples, and deviation of the steps, of a column that is a clock without being called so
_GAP = 12  # times the median step, as in the reading of logs


@dataclass(frozen=True)
class TimeColumn:
    """The column of the stamps (None: not found) and its unit; ``step`` is the median step in s."""

    column: str | None
    unit: str = "s"
    step: float = math.nan
    question: str = ""


def time_column(
    table: DataTable, found: Iterable[ColumnFamily], rows: int, ros: bool, *, nameless: bool = False
) -> TimeColumn:
    """Return the first column of stamps that increases, with its unit: from its name, or from its step.

    Where the columns are ``nameless``, of several that could be the time the likeliest is taken.
    """
    chosen = _stamps(table, found, rows, nameless)
    if rows < 2 or chosen is None:
        return TimeColumn(None)
    name, unit, question = chosen
    column = table.columns[name]
    unit = unit or ("s" if ros else _epoch(column))
    if unit is None:
        return _by_step(name, column, question)
    return TimeColumn(name, unit, _step(column) * UNITS["time"][unit], question)


def _stamps(
    table: DataTable, found: Iterable[ColumnFamily], rows: int, nameless: bool
) -> tuple[str, str | None, str] | None:
    """Return the column of the stamps, by its name or else by its values, the unit in its name, and a question."""
    named = [(column, one.units.get(column)) for one in found if one.role == "time" for column in one.columns.values()]
    named = [*((name, table.units.get(name, unit)) for name, unit in named), *table.units.items()]
    stamps = [(name, unit) for name, unit in named if len(table.columns[name]) == rows]
    if not stamps:
        return _clock(table, rows, nameless)
    name, unit = min(stamps, key=lambda stamp: not increases(table.columns[stamp[0]]))
    column = finite(table.columns[name])
    steps = np.diff(column)  # equal ones are rows written twice, or reading says what to do with them
    sound = len(column) == rows > 1 and bool((steps >= 0).all() and np.median(steps) > 0)
    return name, unit, "" if sound else "the stamps do not increase everywhere: is there a better column?"


def _by_step(name: str, column: Array, question: str) -> TimeColumn:
    """Return stamps whose unit follows from their median step."""
    step = _step(column)
    if _FASTEST <= step <= _SLOWEST:
        return TimeColumn(name, "s", step, question)
    if _counts(column):
        asked = "it counts by one: ms, or samples (then `time: { rate: ... }`)?"
        return TimeColumn(name, "ms", 1e-3, asked)
    unit = next((x for x in ("ms", "us", "ns") if _FASTEST <= step * UNITS["time"][x] <= _SLOWEST), "s")
    asked = f"the median step is {step:.4g}: is this {unit}?"
    return TimeColumn(name, unit, step * UNITS["time"][unit], "; ".join(filter(None, (question, asked))))


def _clock(table: DataTable, rows: int, several: bool) -> tuple[str, str | None, str] | None:
    """Return the column that increases in about equal steps, whatever its name, the unit that the name has, and a
    question; of ``several``, one that does not count samples, and whose steps may be seconds."""
    even = []
    for name, column in table.columns.items():
        if len(column) == rows >= _FEW and increases(column):
            steps = np.diff(column)
            if steps.max() < _GAP * np.median(steps) and np.median(np.abs(steps / np.median(steps) - 1)) < _EVEN:
                even.append(name)
    if not even or (len(even) > 1 and not several):
        return None
    likely = sorted(even, key=lambda name: (_counts(table.columns[name]), not _seconds(table.columns[name])))
    words = re.split("[^a-z]+", likely[0].lower())
    asked = "the only column that increases evenly: is it the time?"
    if likely[1:]:
        asked = f"it increases evenly, as {' and '.join(map(repr, likely[1:]))} do: is it the time?"
    return likely[0], next((unit for unit in UNITS["time"] if unit in words), None), asked


def _counts(column: Array) -> bool:
    """Whether stamps count samples, or ms."""
    return _step(column) == 1 and float(finite(column)[0]).is_integer()


def _seconds(column: Array) -> bool:
    return _FASTEST <= _step(column) <= _SLOWEST


def _epoch(column: Array) -> str | None:
    """Return the unit in which the stamps count from 1970, None where they do not: a year from 2001 to 2049."""
    start = float(finite(column).min(initial=np.inf))
    return next((unit for unit in ("s", "ms", "us", "ns") if 1e9 < start * UNITS["time"][unit] < 2.5e9), None)


def _step(column: Array) -> float:
    """Return the median step, nan where there is none."""
    steps = np.diff(finite(column))
    return float(np.median(steps)) if len(steps) else math.nan


def has_gaps(table: DataTable, time: TimeColumn) -> bool:
    """Whether the stamps leave out far more than a step."""
    if time.column is None:
        return False
    column = table.columns[time.column]
    return bool((np.diff(finite(column)) > _GAP * _step(column)).any())
