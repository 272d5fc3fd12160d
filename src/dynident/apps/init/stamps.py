"""The column of a recording's time stamps: by its name, else by its values, with its unit and its gaps."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dynident.files.tables import DataTable
from dynident.project.columns import ColumnFamily
from dynident.project.fields import UNITS, unit_factor
from dynident.runtime.arrays import Array

_MAX_VALUE = 1e100
_MIN_STEP, _MAX_STEP = 5e-5, 0.3  # s: sampling steps that are taken for granted
# samples, and deviation of the steps, of a column that is a clock without being called so
_MIN_CLOCK_SAMPLES, _MAX_STEP_DEVIATION = 30, 0.1
_LONG_FORMAT_QUESTION = (
    "most rows have the time of the row before: is there a better column? If each row is of another joint, write one "
    "row for each time instead, with a column for each joint and quantity"
)
_CLOCK_PARTS, _MAX_DRIFT = 20, 1.0  # of a recording whose rows are evenly apart; steps that their stamps may drift by
_MAX_ROUNDING = 1e-3  # of the length of a recording: stamps that are rounded more tell no rate
_GAP_RATIO = 12  # times the median step, as in the reading of logs


def is_increasing(column: Array) -> bool:
    """Return whether each value is larger than the one before."""
    return len(column) > 1 and len(finite_values(column)) == len(column) and bool((np.diff(column) > 0).all())


def finite_values(column: Array) -> Array:
    """Return the finite values; larger ones would overflow in a difference."""
    return column[np.abs(column) < _MAX_VALUE]


@dataclass(frozen=True)
class TimeColumn:
    """The column of the stamps (None: not found) and its unit; ``step`` is the median step in s, or nan."""

    column: str | None
    unit: str = "s"
    step: float = math.nan
    question: str = ""


def time_column(
    table: DataTable, column_families: Iterable[ColumnFamily], rows: int, ros: bool, *, nameless: bool = False
) -> TimeColumn:
    """Return the first increasing column of stamps, with its unit from its name, or from its step.

    Where the columns are ``nameless`` and several could be the time, the likeliest is taken.
    """
    stamps = _find_stamps(table, column_families, rows, nameless)
    if rows < 2 or stamps is None:
        return TimeColumn(None)
    name, unit, question = stamps
    column = table.columns[name]
    unit = unit or ("s" if ros else _epoch_unit(column))
    if unit is None:
        return _unit_from_step(name, column, question)
    return TimeColumn(name, unit, _median_step(column) * unit_factor(unit, "time", ""), question)


def _find_stamps(
    table: DataTable, column_families: Iterable[ColumnFamily], rows: int, nameless: bool
) -> tuple[str, str | None, str] | None:
    """Return the column of the stamps, by its name or else its values, the unit in its name, and a question."""
    clocks = [family for family in column_families if family.role == "time"]
    candidates = [(column, family.units.get(column)) for family in clocks for column in family.columns.values()]
    # the unit of a column type outweighs that in its name; columns of dates are candidates without a telling name
    candidates = [*((name, table.units.get(name, unit)) for name, unit in candidates), *table.units.items()]
    stamps = [(name, unit) for name, unit in candidates if len(table.columns[name]) == rows]
    if not stamps:
        return _find_clock(table, rows, nameless)
    name, unit = min(stamps, key=lambda stamp: not is_increasing(table.columns[stamp[0]]))
    column = finite_values(table.columns[name])
    steps = np.diff(column)  # equal ones are rows written twice, or reading says what to do with them
    if len(column) < rows or rows < 2 or (steps < 0).any():
        return name, unit, "the stamps do not increase everywhere: is there a better column?"
    return name, unit, "" if np.median(steps) > 0 else _LONG_FORMAT_QUESTION


def _unit_from_step(name: str, column: Array, question: str) -> TimeColumn:
    """Return the time column with the unit that follows from its median step."""
    step = _median_step(column)
    # a step that is usual in seconds is taken as such; other units are asked about
    if _MIN_STEP <= step <= _MAX_STEP or step == 0:
        return TimeColumn(name, "s", step, question)
    if _is_counter(column):
        unit_question = "it counts by one: ms, or samples (then `time: { rate: ... }`)?"
        return TimeColumn(name, "ms", 1e-3, unit_question)
    unit = next((x for x in ("ms", "us", "ns") if _MIN_STEP <= step * UNITS["time"][x] <= _MAX_STEP), "s")
    unit_question = f"the median step is {step:.4g}: is this {unit}?"
    return TimeColumn(name, unit, step * UNITS["time"][unit], "; ".join(filter(None, (question, unit_question))))


def _find_clock(table: DataTable, rows: int, several: bool) -> tuple[str, str | None, str] | None:
    """Return the column that increases in about equal steps, the unit in its name, and a question.

    Its name does not matter. Of ``several`` candidates, prefer one that does not count samples, and whose steps
    may be seconds.
    """
    clocks = list[str]()
    for name, column in table.columns.items():
        if len(column) == rows >= _MIN_CLOCK_SAMPLES and is_increasing(column):
            ratios = np.diff(column) / np.median(np.diff(column))
            # the median of the deviations ignores a few gaps, which the maximum bounds
            is_even = ratios.max() < _GAP_RATIO and np.median(np.abs(ratios - 1)) < _MAX_STEP_DEVIATION
            # signals that are logged one by one have the same clock each
            if is_even and not any(np.array_equal(column, table.columns[clock]) for clock in clocks):
                clocks.append(name)
    if not clocks or (len(clocks) > 1 and not several):
        return None

    # sample counters come last, and columns in seconds first
    in_seconds = {name: _MIN_STEP <= _median_step(table.columns[name]) <= _MAX_STEP for name in clocks}
    ranked = sorted(clocks, key=lambda name: (_is_counter(table.columns[name]), not in_seconds[name]))
    words = re.split("[^a-z]+", ranked[0].lower())
    question = "the only column that increases evenly: is it the time?"
    if ranked[1:]:
        question = f"it increases evenly, as {' and '.join(map(repr, ranked[1:]))} do: is it the time?"
    return ranked[0], next((unit for unit in UNITS["time"] if unit in words), None), question


def _is_counter(column: Array) -> bool:
    """Return whether stamps count samples, or ms."""
    return _median_step(column) == 1 and float(finite_values(column)[0]).is_integer()


def _epoch_unit(column: Array) -> str | None:
    """Return the unit in which the stamps count from 1970 (a year from 2001 to 2049); None where they do not."""
    start = float(finite_values(column).min(initial=np.inf))
    return next((unit for unit in ("s", "ms", "us", "ns") if 1e9 < start * UNITS["time"][unit] < 2.5e9), None)


def _median_step(column: Array) -> float:
    """Return the median step, nan where there is none."""
    steps = np.diff(finite_values(column))
    return float(np.median(steps)) if len(steps) else math.nan


def even_time(table: DataTable, time: TimeColumn, positions: Iterable[str]) -> TimeColumn:
    """Return the time without its column where rows are evenly apart, but their stamps are not: rounded, or late.

    Rows of equal stamps count where one of the ``positions`` moves from one to the next; others are written twice.
    """
    column = table.columns.get(time.column or "", np.empty(0))
    steps = np.diff(finite_values(column))
    if not _MIN_CLOCK_SAMPLES <= len(steps) == len(column) - 1 or (steps < 0).any() or not steps.any():
        return time
    is_moved = (steps == 0) & np.any([np.diff(table.columns[name]) != 0 for name in positions], axis=0)
    is_late = 0 < _GAP_RATIO * np.median(steps) < steps.max()
    # the earliest stamps of all parts lie on a line, unless rows were lost or the recording paused
    lateness = column - np.arange(len(column)) * steps.mean()
    parts = np.array_split(np.arange(len(column)), _CLOCK_PARTS)
    places = np.array([part[lateness[part].argmin()] for part in parts])
    step, start = np.polyfit(places, column[places] - column[0], 1)
    is_even = float(np.ptp(column[places] - start - step * places)) < _MAX_DRIFT * step
    is_fine = steps[steps > 0].min() < _MAX_ROUNDING * np.ptp(column)
    if not (is_even and is_fine and (is_late or is_moved.any())):
        return time
    question = f"the stamps of {time.column!r} are rounded or late, its rows evenly apart: is this the sampling rate?"
    return TimeColumn(None, step=float(step) * unit_factor(time.unit, "time", ""), question=question)


def has_gaps(table: DataTable, time: TimeColumn) -> bool:
    """Return whether some step of the stamps is far longer than the median, or rows were left out in between."""
    if time.column is None:
        return False
    column, rows = table.columns[time.column], table.rows
    is_gapped = rows is not None and int(np.ptp(rows)) >= len(rows)
    return is_gapped or 0 < _median_step(column) * _GAP_RATIO < float(np.diff(finite_values(column)).max(initial=0.0))
