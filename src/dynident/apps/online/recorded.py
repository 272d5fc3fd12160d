"""Finished recordings as streams: files of which no reader can tell where they grow, such as Parquet and bags."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dynident.apps.online.stream import StreamRead
from dynident.files.parquet import count_rows, read_rows
from dynident.files.tables import DAY, PARQUET, DataTable, is_episode, read_columns, recording_parts
from dynident.runtime import InputError
from dynident.runtime.families import READERS

PIECE_ROWS = 100_000  # of a Parquet file that are read together
LINE_ROWS = 2_000  # rows that are passed on together


def is_recorded(source: str) -> bool:
    """Return whether a source is a recording that is read as a whole: no text, to which another program adds lines."""
    kind = Path(source).suffix.lower()
    is_text = kind not in READERS.kinds() or READERS.table.get(kind) == READERS.table[".csv"]
    return source != "-" and (os.path.isdir(source) or is_episode(Path(source)) or not is_text)


class RecordedFile:
    """A recording at ``path``, of which the ``needed`` columns pass on as JSON lines, from a saved ``position`` on.

    ``time`` is the column of the stamps; ``scalars`` are those of the needed names that are single numbers. Raises
    InputError where a column is missing or the file cannot be read.
    """

    def __init__(
        self, path: Path, needed: Collection[str], time: str | None, position: Mapping[str, Any] | None = None,
        scalars: Collection[str] = (),
    ) -> None:  # fmt: skip
        self.path, self._needed, self._time, self._scalars = path, set(needed), time, set(scalars)
        self._identity = {"recording": str(path.absolute()), **self._version()}
        # another recording, or one written anew, is read from its first row
        same = position is not None and {**position, "row": 0} == {**self._identity, "row": 0}
        self.resumes = not position or same
        self.row = int(position["row"]) if position and same else 0
        self._last = math.nan
        self._chunks = self._read_chunks(self.row)

    def read(self) -> StreamRead:
        """Return the next lines, whether the recording begins with them, and whether its end is reached."""
        fresh = self.row == 0
        chunk = next(self._chunks, [])
        self.row += len(chunk)
        return "".join(f"{line}\n" for line in chunk).encode(), fresh, not chunk

    def position(self, unread: int) -> dict[str, Any]:  # noqa: ARG002
        """Return, in plain types, where to continue: which recording it is, and the row."""
        return {**self._identity, "row": self.row}

    def close(self) -> None:
        """Do nothing: files are open only while they are read."""

    def _version(self) -> dict[str, int]:
        try:
            status = os.stat(self.path)
        except OSError:  # a pattern of names, or none: the reader says which
            return {}
        return {"size": status.st_size, "changed": status.st_mtime_ns}

    def _read_chunks(self, first_row: int) -> Iterator[list[str]]:
        """Yield the rows from a first one on as lines of JSON objects."""
        at = 0
        for table in self._read_tables():
            columns = {name: self._column(table, name) for name in sorted(self._needed - self._scalars)}
            rows = min(map(len, columns.values()))
            if rows < max(map(len, columns.values())):
                raise InputError(f"{table.source}: the configuration's columns differ in length: it has several logs.")
            columns |= {name: np.full(rows, table.constant(name)) for name in sorted(self._scalars)}
            for start in range(max(first_row - at, 0), rows, LINE_ROWS):
                values = np.stack([column[start : start + LINE_ROWS] for column in columns.values()], axis=1).tolist()
                yield [json.dumps(dict(zip(columns, row, strict=True))) for row in values]
            at += rows

    def _column(self, table: DataTable, name: str) -> Any:
        column = table.column(name)
        if name == self._time and table.units.get(name) == "s" and len(column):
            # dates of each piece count from their own midnight: they go on after those before
            if column[0] < self._last:
                column = column + DAY * math.ceil((self._last - column[0]) / DAY)
            self._last = float(column[-1])
        return column

    def _read_tables(self) -> Iterator[DataTable]:
        for part in recording_parts(self.path):
            if part.suffix.lower() == PARQUET:
                total = count_rows(part)
                for start in range(0, total, PIECE_ROWS):
                    yield read_rows(part, self._needed, slice(start, min(start + PIECE_ROWS, total)))
            else:
                yield read_columns(part, needed=self._needed)
