"""Runs the identification of recordings too long for the memory: pieces over an executor, kept in a table."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident import __version__
from dynident.errors import InputError, Step
from dynident.identification import Prepared, Reduced, Span
from dynident.io.families import SMOOTHERS, TERMS
from dynident.io.long_log import LongLog
from dynident.io.row_store import RowStore
from dynident.jobs import Limits, Status, run_jobs

if TYPE_CHECKING:
    import polars as pl

__all__ = ["pieces_name", "reduced"]

KEY = ("piece",)
ARRAYS = ("rows", "factors", "repeated_rows", "repeated_once", "repeated_twice")
LISTED = 3  # pieces that failed, in a message


def pieces_name(ready: Prepared, recordings: Sequence[LongLog]) -> str:
    """Return the name of the table of pieces: another one wherever their factors are others."""
    recipe, model = ready.reducer.recipe, ready.reducer.model
    (smoother,) = recipe.smoothers
    what: dict[str, Any] = {
        "version": __version__,
        "model": [model.name, *model.names, repr(model.terms), model.load],
        "smoother": SMOOTHERS.describe(smoother),
        "recipe": [
            repr(one) for one in (recipe.filter, recipe.min_speed, recipe.outliers, ready.reducer.without_rests)
        ],
        "repeated with": [ready.reducer.theta.tolist(), ready.reducer.credible],
        "spans": [vars(one) for one in ready.spans],
        "channels": [one.config.model_dump(mode="json", exclude={"train"}) for one in recordings],
        "files": [[str(path), *_state(path)] for one in recordings for path in one.files],
    }
    if (choice := ready.chosen.calibration.terms) is not None:
        what["terms"] = [TERMS.describe(one) for one in choice.terms]
    text = json.dumps(what, default=str, sort_keys=True)
    return f"pieces-{sha256(text.encode()).hexdigest()[:12]}.parquet"


def _state(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_size, found.st_mtime_ns


def reduced(
    ready: Prepared,
    table: Path | None,
    executor: Executor | None = None,
    limits: Limits | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Reduced]:
    """Return all pieces in the order of their spans, and keep them in ``table``: of those that are there, none is
    reduced again.

    Raises InputError where one cannot be reduced, once all others are.
    """
    number = {span: k for k, span in enumerate(ready.spans)}
    failed: list[tuple[Span, str]] = []
    with RowStore(table, _schema(), KEY) as store:
        due = [span for span, k in number.items() if (k,) not in store]
        for done in run_jobs(ready.reducer, due, executor, limits=limits):
            if done.status is Status.OK and done.value is not None:
                store.add([_row(number[done.job], done.value, done.seconds)])
            else:
                failed.append((done.job, done.reason))
            progress(Step("reducing the pieces", len(store) + len(failed), len(number)))
        if failed:
            store.save()
            raise InputError(_failed(ready, failed, table))
        rows = store.table().sort("piece")
        return list(_pieces(rows))


def _failed(ready: Prepared, failed: Sequence[tuple[Span, str]], table: Path | None) -> str:
    few = sorted(failed, key=lambda one: (one[0].recording, one[0].start))[:LISTED]
    label = ready.reducer.recordings[few[0][0].recording].label
    words = "; ".join(f"rows {span.start + 1} to {span.stop}: {reason}" for span, reason in few)
    kept = "" if table is None else f" The others are kept in {table}."
    return f"{label}: {len(failed)} of {len(ready.spans)} pieces could not be reduced ({words}).{kept}"


def _schema() -> dict[str, Any]:
    import polars as pl

    numbers = {"piece": pl.Int64, "begins": pl.Float64, "ends": pl.Float64, "seconds": pl.Float64}
    return {**numbers, **dict.fromkeys(ARRAYS, pl.Binary)}


def _row(piece: int, value: Reduced, seconds: float) -> Mapping[str, Any]:
    times = {"begins": value.begins, "ends": value.ends, "seconds": seconds}
    count, once, twice = value.repeated
    arrays = _bytes(value.rows), value.factors, _bytes(count), once, twice
    return {"piece": piece, **times, **dict(zip(ARRAYS, arrays, strict=True))}


def _bytes(rows: tuple[int, ...]) -> bytes:
    return np.array(rows, dtype=np.int64).tobytes()


def _rows(content: bytes) -> tuple[int, ...]:
    return tuple(np.frombuffer(content, dtype=np.int64).tolist())


def _pieces(rows: pl.DataFrame) -> Iterator[Reduced]:
    for begins, ends, count, factors, again, once, twice in rows.select("begins", "ends", *ARRAYS).iter_rows():
        yield Reduced(begins, ends, _rows(count), factors, (_rows(again), once, twice))
