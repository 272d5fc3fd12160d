"""The table of a study: one row per fit."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynident.errors import InputError
from dynident.io.opener import content
from dynident.io.row_store import RowStore
from dynident.jobs import Status

if TYPE_CHECKING:
    import polars as pl

__all__ = ["KEY", "Outcome", "key_type", "study_table"]

ADDED = ("reason", "std", "interval")  # columns that tables of older versions lack
KEY = ("scenario", "method", "level", "run", "seed", "version")
HEAD = "rows of a study of dynident that are not yet in its table"  # of older versions, in a text beside it
WEIGHT = 30  # memory of the rows, per byte of their text


class Outcome(StrEnum):
    """Outcome of a fit: without notes, with notes, not converged, or none, since it raised an error, took longer or
    needed more memory than it may, or since its process died."""

    OK = "ok"
    NOTED = "noted"
    UNSETTLED = "unsettled"
    FAILED = Status.FAILED.value
    TIMED_OUT = Status.TIMED_OUT.value
    OUT_OF_MEMORY = Status.OUT_OF_MEMORY.value
    DIED = Status.DIED.value


NONE = (Outcome.FAILED, Outcome.TIMED_OUT, Outcome.OUT_OF_MEMORY, Outcome.DIED)  # another attempt may succeed


@contextmanager
def study_table(path: str | Path | None, *, rerun: bool = False) -> Iterator[RowStore]:
    """Give the rows of a study; where a ``path`` is given, those known from there, and all of them there in the end.

    Fits that gave nothing are not known; with ``rerun`` none is. Raises InputError where a file is not that of a
    study, or another run works on it.
    """
    if path is not None and beside(Path(path)).exists():
        _take_over(Path(path))
    with _store(path, rerun=rerun) as rows:
        found = rows.scan().select("status").unique().collect()["status"].to_list()
        if wrong := [repr(one) for one in found if one not in set(Outcome)]:
            raise InputError(f"{path}: is not a table of a study: {min(wrong)} is no status of a fit; choose another.")
        yield rows


def key_type() -> dict[str, Any]:
    """Return the types of the columns that tell a fit from all others."""
    return {name: kind for name, kind in _schema().items() if name in KEY}


def beside(path: Path) -> Path:
    """Return the file in which older versions kept the rows that are not yet in a table."""
    return path.with_name(f"{path.name}.rows")


def _store(path: str | Path | None, *, rerun: bool = False) -> RowStore:
    return RowStore(path, _schema(), KEY, rerun=rerun, added=ADDED, again={"status": NONE})


def _take_over(path: Path) -> None:
    """Move the rows of an older version from the text into the table, without a last line that was cut."""
    with _store(path) as rows:
        rows.add(_text_rows(beside(path)))
    beside(path).unlink()


def _text_rows(path: Path) -> Sequence[Mapping[str, Any]]:
    import polars as pl

    head, *lines = content(path, weight=WEIGHT, remember=False).split(b"\n")
    try:
        if head != HEAD.encode() and (lines or not HEAD.encode().startswith(head)):
            raise ValueError("it begins otherwise")
        table = pl.DataFrame([json.loads(line) for line in lines[:-1]], schema=_schema())
        if table.select(*KEY, "status").null_count().sum_horizontal().item():
            raise ValueError("a row has empty cells")
    except (ValueError, TypeError, RecursionError, pl.exceptions.PolarsError) as error:
        raise InputError(f"{path}: holds no rows of a study ({error}); delete it and run again.") from error
    return table.to_dicts()


def _schema() -> dict[str, pl.DataType | type[pl.DataType]]:
    import polars as pl

    return {
        "scenario": pl.String, "method": pl.String, "level": pl.Float64, "run": pl.Int64, "seed": pl.Int64,
        "version": pl.String, "status": pl.String, "reason": pl.String, "seconds": pl.Float64,
        "value": pl.List(pl.Float64), "std": pl.List(pl.Float64), "interval": pl.List(pl.Float64),
    }  # fmt: skip
