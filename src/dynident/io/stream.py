"""Samples from lines as they come: of a text file that grows, or of standard input.

A line counts once its end is there. It is a row of a table (CSV and the like, with the names of the columns in the
first line) or a JSON object; which, the first character says. A cell that is no number is a sensor that says nothing; a
line that cannot be read at all is counted and left out.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, choices
from dynident.io.fields import unit_factor
from dynident.io.settings import Config, check_joints
from dynident.io.signals import column_names, joint_values, unwrapped
from dynident.io.tables import DataTable
from dynident.io.text import first_row, row_cells, unit_row
from dynident.models import Joint
from dynident.online import BadLines

__all__ = ["LineReader", "SampleReader", "Samples"]

Array = NDArray[np.float64]
COMMENTS = ("#", "%")
LONGEST = 1 << 20  # bytes of a line: more is none
SHOWN = 80  # characters of a bad line that are shown
DAY = 86_400.0


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples t (N) s, q and tau (N, n) in SI, nan where there is no number; ``bad`` are the lines left out."""

    t: Array
    q: Array
    tau: Array
    bad: BadLines | None = None


@dataclass
class LineReader:
    """Lines from bytes as they come; ``tail`` is the beginning of one whose end is not there."""

    tail: bytes = b""

    def push(self, data: bytes) -> list[str]:
        """Return the lines that end in the data."""
        *lines, self.tail = (self.tail + data).split(b"\n")
        if len(self.tail) > LONGEST:
            lines, self.tail = [*lines, self.tail[:SHOWN]], b""
        return [line.rstrip(b"\r").decode("utf-8", "replace").lstrip("\ufeff") for line in lines]


@dataclass
class SampleReader:
    """Samples of joints from lines, with the channels of a configuration.

    ``names`` and ``separator`` are those of a table, once its first line is known; ``line`` and ``row`` count what was
    read, ``zero`` (s) is the midnight (UTC) from which dates are counted, ``fresh`` says that a file begins, ``turned``
    are the last values of columns that wrap. Raises ConfigError where the configuration does not fit the joints, or
    where a column is missing.
    """

    config: Config
    joints: tuple[Joint, ...]
    source: str
    names: list[str] = field(default_factory=list)
    separator: str | None = None
    line: int = 0
    row: int = 0
    zero: float = math.nan
    fresh: bool = True
    comments: list[str] = field(default_factory=list)
    turned: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_joints(self.config, self.joints)
        spec = self.config.train[0]
        if list(spec.file) != [""]:
            raise ConfigError(
                "the configuration of the result has several files for a recording; a robot is watched by one stream: "
                "write all columns to one file."
            )
        self._needed = sorted(column_names(self.config.model_copy(update={"simulation": None}), spec))
        channels = (self.config.position[joint.name] for joint in self.joints)
        self._wraps = {name: one.wraps for one in channels if one.wraps for name in one.terms}
        self._labelled = {name.rpartition(" [")[0]: name for name in self._needed if name.endswith("]")}  # unit below
        time = self.config.time
        self._factor = unit_factor(time.unit, "time", "time.unit") if time.column else 1.0

    @property
    def state(self) -> dict[str, Any]:
        """What it knows of the stream so far, in plain types."""
        return {name: getattr(self, name) for name in ("names", "separator", "line", "row", "zero", "fresh", "turned")}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved state."""
        for name, value in state.items():
            setattr(self, name, math.nan if value is None and name == "zero" else value)

    def new_file(self) -> None:
        """Expect the names of the columns again, or rows that go on without them."""
        self.line, self.comments, self.fresh = 0, [], True

    def push(self, lines: Iterable[str]) -> Samples:
        """Return the samples of lines."""
        rows, bad = list[list[float]](), list[tuple[int, str]]()
        for text in lines:
            self.line += 1
            if not text.strip():
                continue
            try:
                values = self._values(text)
            except ValueError:
                bad.append((self.line, text[:SHOWN]))
                continue
            if values is not None:
                rows.append(values)
        found = BadLines(math.nan, len(bad), *bad[0]) if bad else None
        return self._samples(np.array(rows).reshape(len(rows), 1 + len(self._needed)), found)

    def _values(self, text: str) -> list[float] | None:
        """Return time and needed columns of a line, None where it holds none; ValueError where it cannot be read."""
        if text.lstrip().startswith("{"):
            return self._timed(self._object(text))
        if text.lstrip().startswith(COMMENTS):
            self.comments = [text]
            return None
        if self.fresh:
            self.fresh = False
            if self._is_head(text):
                return None
        cells = row_cells(text, self.separator)
        if len(cells) == len(self.names) + 1 and not cells[-1]:
            cells = cells[:-1]
        if cells == self.names or unit_row(text, self.names, self.separator) is not None:
            return None  # who writes has begun again, or the units are below the names
        if len(cells) != len(self.names):
            raise ValueError("another number of cells")
        return self._timed(dict(zip(self.names, cells, strict=True)))

    def _is_head(self, text: str) -> bool:
        """Take the names of the columns from the first line, and return whether that is all it holds."""
        names, head, separator = first_row(text, self.comments)
        names = [self._labelled.get(name, name) for name in names] if head else names
        if self.names and not (head and set(self._needed) <= set(names)):
            return False  # the next file goes on without them
        self._require(names)
        self.names, self.separator = names, separator
        return head

    def _require(self, names: Iterable[str]) -> None:
        there = list(names)
        for name in self._needed:
            if name not in there:
                raise ConfigError(f"{self.source}: no column {name!r}; {choices(name, there)}")

    def _object(self, text: str) -> dict[str, Any]:
        try:
            found = json.loads(text)
        except RecursionError as error:
            raise ValueError("too deep") from error
        if not isinstance(found, dict):
            raise ValueError("no object")
        flat = dict(_flat(found))
        if self.fresh:
            self._require(flat)
            self.fresh = False
        return flat

    def _timed(self, cells: Mapping[str, Any]) -> list[float]:
        column = self.config.time.column
        t = self.row / (self.config.time.rate or 1.0) if column is None else self._time(cells.get(column))
        self.row += 1
        return [t, *(_number(cells.get(name)) for name in self._needed)]

    def _time(self, cell: Any) -> float:
        t = self._factor * _number(cell)
        if math.isnan(t) and isinstance(cell, str):
            date = datetime.fromisoformat(cell.strip())  # ValueError where it is none
            stamp = (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
            if math.isnan(self.zero):
                self.zero = DAY * math.floor(stamp / DAY)
            t = stamp - self.zero
        if not math.isfinite(t):
            raise ValueError("no time")
        return t

    def _samples(self, values: Array, bad: BadLines | None) -> Samples:
        n = len(self.joints)
        if not len(values):
            return Samples(np.zeros(0), np.zeros((0, n)), np.zeros((0, n)), bad)
        columns = {name: self._going_on(name, values[:, k + 1].copy()) for k, name in enumerate(self._needed)}
        q, tau = joint_values(DataTable(columns, {}, self.source), self.config, self.joints)
        return Samples(values[:, 0].copy(), q, tau, bad)

    def _going_on(self, name: str, column: Array) -> Array:
        """Return a column that starts anew somewhere as it goes on from the samples before."""
        if (wraps := self._wraps.get(name)) is None:
            return column
        before = [self.turned[name]] if name in self.turned else []
        column = unwrapped(np.array([*before, *column]), wraps)[len(before) :]
        if np.isfinite(column).any():
            self.turned[name] = float(column[np.isfinite(column)][-1])
        return column


def _number(cell: Any) -> float:
    """Return the number of a cell, nan where there is none."""
    if isinstance(cell, str):
        cell = cell.strip()
        if "," in cell and "." not in cell:  # a decimal comma: the separator is another
            cell = cell.replace(",", ".")
    try:
        value = float(cell)
    except (TypeError, ValueError):
        return math.nan
    return value if abs(value) < 1e100 else math.nan


def _flat(value: Any, name: str = "") -> Iterable[tuple[str, Any]]:
    """Yield what an object holds by names joined by points, such as ``elbow.position`` or ``q.2``."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if inside is None:
        yield name, value
        return
    for key, one in inside:
        yield from _flat(one, f"{name}.{key}" if name else str(key))
