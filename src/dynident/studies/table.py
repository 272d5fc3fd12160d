"""The table of a study: one row per fit, in a file to which rows are added as they come."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any

from dynident.errors import InputError, listed
from dynident.io.opener import content
from dynident.io.results import append_log, read_table, write_table

if TYPE_CHECKING:
    import polars as pl

__all__ = ["KEY", "Outcome", "StudyTable", "frame", "key_of"]

ADDED = ("reason", "std", "interval")  # columns that tables of older versions lack
KEY = ("scenario", "method", "level", "run", "seed", "version")
SAVE_EVERY = 2.0  # seconds between additions to the file
HEAD = "rows of a study of dynident that are not yet in its table"
WEIGHT = 30  # memory of the rows, per byte of their text


class Outcome(StrEnum):
    """Outcome of a fit: without notes, with notes, not converged, or failed."""

    OK = "ok"
    NOTED = "noted"
    UNSETTLED = "unsettled"
    FAILED = "failed"


class StudyTable:
    """The rows of a study; where a ``path`` is given, those known from there, and all of them there in the end.

    While it grows, new rows are added to a text beside the table, one line of JSON each, every two seconds. The end,
    whatever it is, writes the whole table and removes the text; after a run that was killed, the next one reads both,
    and leaves out a line that was cut. Failed fits are not known: another attempt may succeed. Raises InputError where
    a file is not that of a study.
    """

    def __init__(self, path: str | Path | None) -> None:
        self.path = None if path is None else Path(path)
        self.rows: list[dict[str, Any]] = [] if self.path is None else _known(self.path)
        self._new: list[dict[str, Any]] = []
        self._text: IO[str] | None = None
        self._saved = time.monotonic()

    def __enter__(self) -> StudyTable:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.path is None:
            return
        if self._text is not None:
            self._text.close()
        self._write(self.path)

    def add(self, rows: Sequence[dict[str, Any]]) -> None:
        """Add rows of new fits."""
        self.rows += rows
        self._new += rows
        if self.path is not None and time.monotonic() - self._saved > SAVE_EVERY:
            self._append(self.path)

    def _append(self, path: Path) -> None:
        if self._text is None:
            if beside(path).exists():  # of a killed run, and its last line may be cut
                self._write(path)
            self._text = append_log(beside(path), HEAD)
        self._text.write("".join(f"{json.dumps(row)}\n" for row in self._new))
        self._text.flush()
        os.fsync(self._text.fileno())
        self._new, self._saved = [], time.monotonic()

    def _write(self, path: Path) -> None:
        write_table(path, frame(self.rows))
        beside(path).unlink(missing_ok=True)


def beside(path: Path) -> Path:
    """Return the file of the rows that are not yet in a table."""
    return path.with_name(f"{path.name}.rows")


def key_of(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return what tells a fit from all others."""
    return tuple(row[name] for name in KEY)


def frame(rows: Sequence[Mapping[str, Any]]) -> pl.DataFrame:
    """Return rows as a table."""
    import polars as pl

    return pl.DataFrame(rows, schema=_schema())


def _known(path: Path) -> list[dict[str, Any]]:
    """Return the rows of the table and of the text beside it, each fit once, without those that failed."""
    tables = {path: read_table(path)} if path.exists() else {}
    if beside(path).exists():
        tables[beside(path)] = _text_rows(beside(path))
    for file, table in tables.items():
        if reason := _foreign(table):
            raise InputError(f"{file}: is not a table of a study: {reason}; choose another file or folder.")
    rows = [row for table in tables.values() for row in table.to_dicts() if row["status"] != Outcome.FAILED]
    return list({key_of(row): row for row in rows}.values())


def _text_rows(path: Path) -> pl.DataFrame:
    """Return the rows of a text, without a last line that was cut."""
    import polars as pl

    head, *lines = content(path, weight=WEIGHT, remember=False).split(b"\n")
    try:
        if head != HEAD.encode() and (lines or not HEAD.encode().startswith(head)):
            raise ValueError("it begins otherwise")
        return frame([json.loads(line) for line in lines[:-1]])
    except (ValueError, TypeError, RecursionError, pl.exceptions.PolarsError) as error:
        raise InputError(f"{path}: holds no rows of a study ({error}); delete it and run again.") from error


def _foreign(table: pl.DataFrame) -> str:
    """Return why a table is not one that a study wrote, empty where it is one."""
    for name, kind in _schema().items():
        if name not in table.columns:
            if name not in ADDED:
                return f"it has no column {name!r} (columns {listed(table.columns)})"
        elif table.schema[name] != kind:
            return f"its column {name!r} holds {table.schema[name]}, not {kind}"
    if more := [name for name in table.columns if name not in _schema()]:
        return f"no study has the column {more[0]!r}"
    for name in (*KEY, "status"):
        if table[name].null_count():
            return f"its column {name!r} has empty cells"
    if wrong := set(table["status"]) - set(Outcome):
        return f"{min(wrong)!r} is no status of a fit"
    return "a fit stands in it twice" if table.select(KEY).is_duplicated().any() else ""


def _schema() -> dict[str, pl.DataType | type[pl.DataType]]:
    import polars as pl

    return {
        "scenario": pl.String, "method": pl.String, "level": pl.Float64, "run": pl.Int64, "seed": pl.Int64,
        "version": pl.String, "status": pl.String, "reason": pl.String, "seconds": pl.Float64,
        "value": pl.List(pl.Float64), "std": pl.List(pl.Float64), "interval": pl.List(pl.Float64),
    }  # fmt: skip
