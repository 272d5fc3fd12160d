"""Samples from lines as they arrive, of a growing text file or of standard input.

A line counts once its end has arrived. Its first character tells whether it is a row of a table (CSV and the
like, with the column names in the first line) or a JSON object. A cell that is not a number is a missing
value of a sensor; a line that cannot be read at all is counted and left out.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from dynident.apps.online.events import BadLines
from dynident.apps.online.watcher import MAX_TIME
from dynident.files.opener import file_status, open_input
from dynident.files.stamps import iso_stamp
from dynident.files.tables import DAY, DataTable
from dynident.files.text import first_row, row_cells, unit_row
from dynident.models import Joint
from dynident.project.fields import Channel, unit_factor
from dynident.project.settings import Config, check_joints
from dynident.project.signals import column_names, joint_values, unwrap
from dynident.runtime import ConfigError, InputError, Noun, choices
from dynident.runtime.arrays import Array

CHUNK_SIZE = 1 << 20  # bytes
MARK_SIZE = 256  # bytes before a position that say whether it is the same file

StreamRead = tuple[bytes, bool, bool]
COMMENT_MARKS = ("#", "%")
MAX_LINE_LENGTH = 1 << 18  # characters of a line: with more it is no sample
MAX_LINE_BYTES = 4 * MAX_LINE_LENGTH  # bytes that surely are more characters
MAX_SHOWN_CHARACTERS = 80  # characters of a bad line that are shown
MAX_NAME_LENGTH = 256  # characters of the name of a nested value: what is deeper is not read


class StandardInput:
    """Standard input, which cannot be read again; it ends when its writer does.

    Raises InputError where there is none.
    """

    resumes = False

    def __init__(self) -> None:
        if sys.stdin is None:  # closed by who started this
            raise InputError("standard input is closed; give the path of a file, or write to it: ... | dynident watch")
        self._file = sys.stdin.buffer

    def read(self) -> StreamRead:
        """Return the available bytes, whether a new file begins with them, and whether the end is final."""
        data = self._file.read1(CHUNK_SIZE) if hasattr(self._file, "read1") else self._file.read(CHUNK_SIZE)
        return data, False, not data

    def position(self, unread: int) -> dict[str, Any]:  # noqa: ARG002
        """Return nothing: what was read cannot be read again."""
        return {}

    def close(self) -> None:
        """Leave it open: this process does not own it."""


class FollowedFile:
    """A regular file at ``path``, read from its beginning or from a saved ``position``.

    After a rotation, the rest of the old file is read, then the new file from its beginning. A file that became
    shorter is read from its beginning, too. Raises InputError where it cannot be read.
    """

    def __init__(self, path: Path, position: Mapping[str, Any] | None = None) -> None:
        self.path, self.offset, self._fresh = path, 0, True
        self.resumes = not position  # whether it goes on where it was
        self._stack = ExitStack()
        self._file = self._begin(position if position and "offset" in position else {})

    def read(self) -> StreamRead:
        """Return new bytes, at most a megabyte, whether a new file begins with them, and False: there is no end."""
        data = self._file.read(CHUNK_SIZE)
        # the old file is read to its end before the one that took its name
        if not data and self._is_replaced():
            self._open(self.path)
            self._fresh = True
            data = self._file.read(CHUNK_SIZE)
        self.offset += len(data)
        fresh, self._fresh = (self._fresh, False) if data else (False, self._fresh)
        return data, fresh, False

    def position(self, unread: int) -> dict[str, Any]:
        """Return, in plain types, where to continue if the last ``unread`` bytes are to be read again.

        That is which file it is, the offset, and a digest of the bytes before.
        """
        status, at = os.fstat(self._file.fileno()), self.offset - unread
        return {"device": status.st_dev, "inode": status.st_ino, "offset": at, "mark": self._mark(self._file, at)}

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _begin(self, position: Mapping[str, Any]) -> BinaryIO:
        """Open the file that was being read, by any name in the same folder; else the one at the path."""
        file_status(self.path, InputError)
        for path in (self.path, *self._renamed_files(position)):
            file = self._open(path)
            # an inode can be reused: the digest of the bytes before the offset tells whether it is the same file
            if position and self._mark(file, int(position["offset"])) == position["mark"]:
                self.offset, self.resumes, self._fresh = int(position["offset"]), True, False
                file.seek(self.offset)
                return file
        return self._open(self.path)

    def _renamed_files(self, position: Mapping[str, Any]) -> list[Path]:
        """Return the files of the folder with the identity of a saved position, under another name."""
        # device and inode survive a rename, as in a rotation
        identity = position.get("device"), position.get("inode")
        try:
            files = [Path(entry.path) for entry in os.scandir(self.path.parent) if entry.is_file()]
            return [entry for entry in files if (os.stat(entry).st_dev, os.stat(entry).st_ino) == identity]
        except OSError:
            return []

    def _open(self, path: Path) -> BinaryIO:
        self._stack.close()
        self._file = self._stack.enter_context(open_input(path, InputError))
        self.offset = 0
        return self._file

    def _mark(self, file: BinaryIO, offset: int) -> str:
        """Return a digest of the bytes before an offset, empty where they are not all there."""
        current = file.tell()
        file.seek(max(offset - MARK_SIZE, 0))
        data = file.read(min(MARK_SIZE, offset))
        file.seek(current)
        return sha256(data).hexdigest() if len(data) == min(MARK_SIZE, offset) else ""

    def _is_replaced(self) -> bool:
        """Return whether another file has the name now, or this one was cut."""
        try:
            named_status = os.stat(self.path)
        except OSError:
            return False  # between two files
        open_status = os.fstat(self._file.fileno())
        return not os.path.samestat(named_status, open_status) or open_status.st_size < self.offset


class StreamSamples(Noun):
    """Samples t (N) s, q and tau (N, n) in SI, nan for missing numbers; ``bad`` describes the lines left out."""

    t: Array
    q: Array
    tau: Array
    bad: BadLines | None = None


@dataclass
class LineReader:
    """Lines from bytes as they arrive; ``tail`` is the beginning of a line whose end is missing.

    ``skipping`` says that the rest of a line is left out, up to its end.
    """

    tail: bytes = b""
    skipping: bool = False

    def push(self, data: bytes) -> list[str]:
        """Return the lines that end in the data, and the beginning of one that is too long."""
        if self.skipping:
            _, end, data = data.partition(b"\n")
            self.skipping = not end
        # the last piece has no end yet, and waits for more bytes
        *lines, self.tail = (self.tail + data).split(b"\n")
        # a line this long is no sample, and must not fill the memory: its rest is not kept
        if len(self.tail) > MAX_LINE_BYTES:
            lines, self.tail, self.skipping = [*lines, self.tail], b"", True
        return [line.rstrip(b"\r").decode("utf-8", "replace").lstrip("\ufeff") for line in lines]


@dataclass
class SampleReader:
    """Samples of joints from lines, with the channels of a configuration.

    ``needed`` are the columns that it takes, among them ``scalars``, numbers that gains name; ``names`` and
    ``separator`` are those of a table, known after its first line; ``line`` and ``row`` count what was read; ``zero``
    (s) is the midnight (UTC) from which dates count; ``fresh`` says that a file begins; ``latest`` are the last values
    of scalars, and of columns that wrap. Raises ConfigError where the configuration does not fit the joints, or a
    column is missing.
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
    latest: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_joints(self.config, self.joints)
        spec = self.config.train[0]
        if list(spec.file) != [""]:
            raise ConfigError(
                "the configuration of the result has several files for a recording; a robot is watched by one stream: "
                "write all columns to one file."
            )
        channels: list[Channel] = [*self.config.position.values(), *self.config.torque.values()]
        self.scalars = frozenset[str]().union(*(channel.scalars for channel in channels))
        columns = column_names(self.config.model_copy(update={"simulation": None}), spec)
        self.needed = sorted(columns | self.scalars)
        positions = (self.config.position[joint.name] for joint in self.joints)
        self._wraps = {name: channel.wraps for channel in positions if channel.wraps for name in channel.terms}
        self._labelled = {name.rpartition(" [")[0]: name for name in self.needed if name.endswith("]")}  # unit below
        time = self.config.time
        self._factor = unit_factor(time.unit, "time", "time.unit") if time.column else 1.0

    @property
    def state(self) -> dict[str, Any]:
        """What the reader knows of the stream so far, in plain types."""
        return {name: getattr(self, name) for name in ("names", "separator", "line", "row", "zero", "fresh", "latest")}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved state."""
        for name, value in state.items():
            setattr(self, name, math.nan if value is None and name == "zero" else value)

    def new_file(self) -> None:
        """Expect a line of column names again, or rows that continue without one."""
        self.line, self.comments, self.fresh = 0, [], True

    def push(self, lines: Iterable[str]) -> StreamSamples:
        """Return the samples of lines."""
        rows, bad = list[list[float]](), list[tuple[int, str]]()
        for text in lines:
            self.line += 1
            if not text.strip():
                continue
            try:
                values = self._parse_line(text)
            except ValueError:
                bad.append((self.line, text[:MAX_SHOWN_CHARACTERS]))
                continue
            if values is not None:
                rows.append(values)
        bad_lines = BadLines(math.nan, len(bad), *bad[0], bad[-1][0]) if bad else None
        return self._make_samples(np.array(rows).reshape(len(rows), 1 + len(self.needed)), bad_lines)

    def _parse_line(self, text: str) -> list[float] | None:
        """Return time and needed columns of a line, None where it holds none; ValueError where it cannot be read."""
        if len(text) > MAX_LINE_LENGTH:
            raise ValueError("too long")
        if text.lstrip().startswith("{"):
            return self._row_values(self._parse_object(text))
        # only the last comment or title is kept: it may hold the column names
        if text.lstrip().startswith(COMMENT_MARKS) or self._is_title(text):
            self.comments = [text]
            return None
        if self.fresh:
            is_header = self._take_header(text)
            self.fresh = False
            if is_header:
                return None
        cells = row_cells(text, self.separator)
        # some recorders end each line with a separator
        if len(cells) == len(self.names) + 1 and not cells[-1]:
            cells = cells[:-1]
        if cells == self.names or unit_row(text, self.names, self.separator) is not None:
            return None  # who writes has begun again, or the units are below the names
        if len(cells) != len(self.names):
            raise ValueError("another number of cells")
        return self._row_values(dict(zip(self.names, cells, strict=True)))

    def _is_title(self, text: str) -> bool:
        """Return whether a line stands above the names of the columns: words, fewer than are needed."""
        if not self.fresh or self.names:
            return False
        names, is_header, _ = first_row(text, self.comments)
        return is_header and len(names) < len(self.needed)

    def _take_header(self, text: str) -> bool:
        """Take the column names from the first line; return whether the line holds nothing else."""
        names, is_header, separator = first_row(text, self.comments)
        names = [self._labelled.get(name, name) for name in names] if is_header else names
        if self.names and not (is_header and set(self.needed) <= set(names)):
            return False  # the next file goes on without them
        self._require_columns(names)
        self.names, self.separator = names, separator
        return is_header

    def _require_columns(self, names: Iterable[str]) -> None:
        available = list(names)
        for name in self.needed:
            if name not in available:
                raise ConfigError(f"{self.source}: no column {name!r}; {choices(name, available)}")

    def _parse_object(self, text: str) -> dict[str, Any]:
        try:
            values = dict(_flatten(json.loads(text)))
        except RecursionError as error:
            raise ValueError("too deep") from error
        # other programs may add objects of their own: only the very first sample must have all columns
        if self.fresh and not self.row:
            self._require_columns(values)
        self.fresh = False
        return values

    def _row_values(self, cells: Mapping[str, Any]) -> list[float]:
        column = self.config.time.column
        # without a column of stamps, the rows count the time
        t = self.row / (self.config.time.rate or 1.0) if column is None else self._parse_time(cells.get(column))
        self.row += 1
        return [t, *(_parse_number(cells.get(name)) for name in self.needed)]

    def _parse_time(self, cell: Any) -> float:
        t = self._factor * _parse_number(cell)
        if math.isnan(t) and isinstance(cell, str):
            date = datetime.fromisoformat(iso_stamp(cell.strip()))  # ValueError where it is none
            stamp = (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
            # counted from the first midnight, as float64 is too coarse for seconds since 1970
            if math.isnan(self.zero):
                self.zero = DAY * math.floor(stamp / DAY)
            t = stamp - self.zero
        if not abs(t) <= MAX_TIME:
            raise ValueError("no time")
        return t

    def _make_samples(self, values: Array, bad: BadLines | None) -> StreamSamples:
        n = len(self.joints)
        if not len(values):
            return StreamSamples(np.zeros(0), np.zeros((0, n)), np.zeros((0, n)), bad)
        columns = {name: self._unwrap(name, values[:, k + 1].copy()) for k, name in enumerate(self.needed)}
        for name in self.scalars & columns.keys():  # a stream says a scalar in each row: the last number holds
            column = columns.pop(name)
            if np.isfinite(column).any():
                self.latest[name] = float(column[np.isfinite(column)][-1])
        scalars = {name: self.latest.get(name, math.nan) for name in self.scalars}
        if np.isnan(list(scalars.values())).any():
            unknown = np.full((len(values), n), math.nan)
            return StreamSamples(values[:, 0].copy(), unknown, unknown.copy(), bad)
        q, tau = joint_values(DataTable(columns, scalars, self.source), self.config, self.joints)
        return StreamSamples(values[:, 0].copy(), q, tau, bad)

    def _unwrap(self, name: str, column: Array) -> Array:
        """Return a wrapped column continued from the samples before."""
        if (wraps := self._wraps.get(name)) is None:
            return column
        previous = [self.latest[name]] if name in self.latest else []
        # the last value of the previous samples is put in front, so that a wrap between two reads is found
        column = unwrap(np.array([*previous, *column]), wraps)[len(previous) :]
        if np.isfinite(column).any():
            self.latest[name] = float(column[np.isfinite(column)][-1])
        return column


def _parse_number(cell: Any) -> float:
    """Return the number of a cell, nan where there is none."""
    if isinstance(cell, str):
        cell = cell.strip()
        if "," in cell and "." not in cell:  # a decimal comma: the separator is another
            cell = cell.replace(",", ".")
    try:
        value = float(cell)
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return value if abs(value) < 1e100 else math.nan


def _flatten(value: Any, name: str = "") -> Iterable[tuple[str, Any]]:
    """Yield the values of an object by names joined by points, such as ``elbow.position`` or ``q.2``."""
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if children is None:
        yield name, value
        return
    # names grow with each level: long ones, of many values, would fill the memory
    if len(name) <= MAX_NAME_LENGTH:
        for key, child in children:
            yield from _flatten(child, f"{name}.{key}" if name else str(key))
