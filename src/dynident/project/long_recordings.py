"""Runs the identification of recordings too long for the memory: pieces over an executor, kept in a table."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident._version import __version__
from dynident.checks import MAX_GAP_STEPS, MINIMUM_SAMPLES
from dynident.files.opener import file_stamp
from dynident.files.parquet import count_rows, read_rows
from dynident.files.row_store import RowStore
from dynident.files.tables import DAY, PARQUET, DataTable, join_tables, recording_parts
from dynident.identification import PieceFactors, PiecePlan, Span, Stretch
from dynident.models import Joint
from dynident.motion.log import Log
from dynident.project.fields import Interval, interval_ends, unit_factor
from dynident.project.logs import log_of, without_excluded
from dynident.project.settings import Config, LogSpec, check_joints
from dynident.project.signals import check_times, column_names, order_hint
from dynident.runtime import ConfigError, InputError, Noun, Step, memory_budget, report_progress
from dynident.runtime.arrays import Array
from dynident.runtime.families import SMOOTHERS, TERMS
from dynident.runtime.jobs import Limits, Status, run_jobs

BYTES_PER_SAMPLE = 160  # bytes of memory per sample and joint that an identification takes where it holds all samples
MAX_BYTES_AT_ONCE = 600_000_000  # of a training; what takes more is fitted in pieces where that is possible
CHUNK = 1_000_000  # stamps that are looked at together
KEY = ("piece",)
ARRAYS = ("rows", "factors", "repeated_rows", "repeated_once", "repeated_twice")
MAX_LISTED_FAILURES = 3  # pieces that failed, in a message


@dataclass(frozen=True)
class RecordedPart:
    """A Parquet file of a recording, and the number of its rows."""

    path: Path
    rows: int


class LongLog(Noun):
    """A recording that stays in its files: ``parts`` one after the other, ``stretches`` of rows without gaps.

    ``step`` (s) is the usual one between samples; ``notes`` say what of the recording is not used. It is picklable, so
    that any process that sees the files can ``read`` of it.
    """

    label: str
    config: Config
    joints: tuple[Joint, ...]
    parts: tuple[RecordedPart, ...]
    stretches: tuple[Stretch, ...] = ()
    step: float = 0.0
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return sum(part.rows for part in self.parts)

    @property
    def files(self) -> tuple[Path, ...]:
        """Its files."""
        return tuple(part.path for part in self.parts)

    def read(self, rows: slice) -> tuple[Log, NDArray[np.intp]]:
        """Return the log of some rows, between which there is no gap, and which of them it has: all but repeated ones.

        Raises InputError where a value cannot be used, with its file and row.
        """
        table = self._table(rows, column_names(self.config, self.config.train[0]))
        first_row = 0 if table.rows is None else int(table.rows[0])
        log, kept_rows = log_of(table, self.config, self.joints, self.label)
        log = replace(log, t=log.t + self._time_shift(rows.start, log, table))
        return without_excluded(log, self.config.train[0]), kept_rows - first_row

    def _time_shift(self, row: int, log: Log, table: DataTable) -> float:
        """Return the shift (s) to add to the times of a log that starts at a row, which are counted from another
        origin."""
        time = self.config.time
        if time.rate is not None:
            return row / time.rate
        if table.units.get(time.column or "") != "s":
            return 0.0
        # times of day that are read from the middle may count from another day: shift them by whole days
        stretch = next((candidate for candidate in self.stretches if candidate.start <= row < candidate.stop), None)
        expected = log.t[0] if stretch is None else stretch.begins + (row - stretch.start) * self.step
        return DAY * round((expected - float(log.t[0])) / DAY)

    def _table(self, rows: slice, needed: set[str]) -> DataTable:
        tables, at = [], 0
        for part in self.parts:
            start, stop = max(rows.start - at, 0), min(rows.stop - at, part.rows)
            if start < stop:
                tables.append(read_rows(part.path, needed, slice(start, stop)))
            at += part.rows
        if len(tables) == 1:
            return tables[0]
        return join_tables(tables, f"{tables[0].source} from row {tables[0].place(0).removeprefix('row ')} on")

    def stamps(self) -> Iterator[tuple[int, Array]]:
        """Yield the first row and the times (s) of all samples, about a million at a time.

        Raises InputError where one is missing, or they run backwards.
        """
        time, at = self.config.time, 0
        if time.rate is not None:
            for start in range(0, len(self), CHUNK):
                yield start, np.arange(start, min(start + CHUNK, len(self))) / time.rate
            return
        factor, last, name = unit_factor(time.unit, "time", "time.unit"), -np.inf, time.column or ""
        for part in self.parts:
            for start in range(0, part.rows, CHUNK):
                table = read_rows(part.path, {name}, slice(start, min(start + CHUNK, part.rows)))
                t = factor * table.column(name, "time")
                # times of day start anew at midnight, and go on after what precedes
                if table.units.get(name) == "s" and t[0] < last:
                    t = t + DAY * np.ceil((last - t[0]) / DAY)
                self._check_stamps(table, name, t, last)
                yield at + start, t
                last = float(t[-1])
            at += part.rows

    def _check_stamps(self, table: DataTable, name: str, t: Array, last: float) -> None:
        check_times(table, name, t)
        if t[0] < last:
            raise InputError(
                f"{table.source}: begins at {t[0]:.9g} s, before the end of what precedes it ({last:.9g} s): the parts "
                f"of {self.label!r} must follow one another in the order of their names, and their time go on."
            )
        back = np.flatnonzero(np.diff(t) < 0)
        if len(back):
            raise InputError(
                f"{table.source}: column {name!r}: the time runs backwards at {table.place(back[0] + 1)} "
                f"({len(back)} such rows); {order_hint(table.column(name))}."
            )

    def plan_stretches(self, windows: Sequence[Interval]) -> LongLog:
        """Return the recording with the stretches of its rows in the windows (all of it, where there are none).

        Raises InputError where it has gaps that must not be split, or nothing is left.
        """
        stretches: list[Stretch] = []
        gaps: list[tuple[float, float]] = []
        previous_time, previous_window, step, total = np.nan, -1, 0.0, len(self)
        for start, t in self.stamps():
            report_progress(Step(f"reading the times of {self.label}", start, total))
            # the usual step is that of the first chunk
            if not step:
                steps = np.diff(t)
                step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
            # gaps and changes of window count across the edge of a chunk, too
            window = _window_numbers(t, windows)
            is_gap = np.diff(t, prepend=previous_time) > MAX_GAP_STEPS * step
            gaps += [(float(t[k - 1] if k else previous_time), float(t[k])) for k in np.flatnonzero(is_gap)]
            is_start = is_gap | (np.diff(window, prepend=previous_window) != 0)
            edges = [0, *np.flatnonzero(is_start[1:]) + 1, len(t)]
            for a, b in pairwise(edges):
                if window[a] < 0:
                    continue
                # the last stretch goes on, unless the chunk begins with a new one
                if a == 0 and not is_start[0] and stretches:
                    stretches[-1] = replace(stretches[-1], stop=start + b, ends=float(t[b - 1]))
                else:
                    stretches.append(Stretch(start + a, start + b, float(t[a]), float(t[b - 1])))
            previous_time, previous_window = float(t[-1]), int(window[-1])
        return self._with_stretches(stretches, gaps, step)

    def _with_stretches(self, stretches: list[Stretch], gaps: list[tuple[float, float]], step: float) -> LongLog:
        words = _gap_words(gaps, step)
        if gaps and self.config.gaps == "error":
            raise InputError(
                f"{self.label}: {words}; `gaps: split` fits what is between them, a `window` leaves them out."
            )
        kept_stretches = tuple(stretch for stretch in stretches if stretch.stop - stretch.start >= MINIMUM_SAMPLES)
        if not kept_stretches:
            raise InputError(f"{self.label}: nothing of the recording is left; look at its windows and gaps.")
        total, kept = (sum(part.stop - part.start for part in parts) for parts in (stretches, kept_stretches))
        notes = [f"{self.label}: {words}; no piece reaches over one."] if gaps else []
        if lost := total - kept:
            notes.append(f"{self.label}: {lost} samples between gaps are too few to be smoothed, and left out.")
        return replace(self, stretches=kept_stretches, step=step, notes=tuple(notes))


def _gap_words(gaps: Sequence[tuple[float, float]], step: float) -> str:
    if not gaps:
        return ""
    start, stop = max(gaps, key=lambda gap: gap[1] - gap[0])
    return (
        f"has {len(gaps)} gap{'s' * (len(gaps) > 1)}, the longest from {start:.9g} to {stop:.9g} s "
        f"({stop - start:.4g} s, where {step:.3g} s is usual)"
    )


def _window_numbers(t: Array, windows: Sequence[Interval]) -> NDArray[Any]:
    """Return the number of the window that each time is in, -1 where there is none."""
    if not windows:
        return np.zeros(len(t), dtype=int)
    out = np.full(len(t), -1)
    for k, (start, stop) in enumerate(map(interval_ends, windows)):
        out[(t >= start) & (t <= stop)] = k
    return out


def is_long(config: Config) -> bool:
    """Return whether the training needs more than the memory; rows are counted by the footers of the files.

    Raises InputError where a Parquet file cannot be read.
    """
    return _training_bytes(config) > memory_budget()


def saves_memory(config: Config) -> bool:
    """Return whether a training that the memory would hold is so large that it is better fitted in pieces.

    All of its files can then be read so. Raises InputError where a Parquet file cannot be read.
    """
    has_one_file = all(list(spec.file) == [""] for spec in config.train)
    parts = (part for spec in config.train for path in spec.file.values() for part in recording_parts(path))
    in_parquet = has_one_file and all(part.suffix.lower() == PARQUET for part in parts)
    wraps = any(channel.wraps for channel in config.position.values())
    return in_parquet and not wraps and _training_bytes(config) > MAX_BYTES_AT_ONCE


def _training_bytes(config: Config) -> int:
    files = {file for spec in config.train for path in spec.file.values() for file in recording_parts(path)}
    rows = sum(count_rows(file) for file in files if file.suffix.lower() == PARQUET and os.path.exists(file))
    return rows * len(config.position) * BYTES_PER_SAMPLE


def long_logs(config: Config, joints: Sequence[Joint]) -> tuple[LongLog, ...]:
    """Return the recordings of the training as they lie in their files.

    Raises ConfigError where the channels do not fit the joints, and InputError where a recording is no Parquet file, or
    its times cannot be used.
    """
    check_joints(config, joints)
    return tuple(_open_recording(spec, config, tuple(joints)) for spec in config.train)


def _open_recording(spec: LogSpec, config: Config, joints: tuple[Joint, ...]) -> LongLog:
    files = [file.absolute() for path in spec.file.values() for file in recording_parts(path)]
    non_parquet = next((file for file in files if file.suffix.lower() != PARQUET), None)
    if non_parquet is not None or list(spec.file) != [""]:
        raise InputError(
            f"{spec.label}: the recordings of `train` are too long for the memory, and {non_parquet or 'this one'} "
            "cannot be read in pieces: write all of its columns to Parquet files, choose a shorter `window` of a "
            "shorter file, or raise the memory by --memory."
        )
    if any(config.position[joint.name].wraps for joint in joints):
        raise ConfigError(
            "position: `wraps` is not known to recordings that are read in pieces, which would not agree on the turn: "
            "write the positions as they go on, for example by numpy.unwrap."
        )
    # a log travels to other processes: leave out what reading does not need
    nothing = dict.fromkeys(("smoother", "estimator", "simulation"))
    channels = config.model_copy(update={"train": (spec,), "validation": (), "model": "", **nothing})
    parts = tuple(RecordedPart(file, count_rows(file)) for file in files)
    return LongLog(spec.label, channels, joints, parts).plan_stretches(spec.window)


def pieces_name(preparation: PiecePlan, recordings: Sequence[LongLog]) -> str:
    """Return the file name of the table of pieces, with a digest of everything that their factors depend on."""
    recipe, model = preparation.reducer.recipe, preparation.reducer.model
    (smoother,) = recipe.smoothers
    # a setting that changes the factors must be in here, or stale pieces would be used
    identity: dict[str, Any] = {
        "version": __version__,
        "model": [model.name, *model.names, repr(model.terms), model.load],
        "smoother": SMOOTHERS.describe(smoother),
        "recipe": [
            repr(part) for part in (recipe.filter, recipe.min_speed, recipe.outliers, preparation.reducer.without_rests)
        ],
        "repeated with": [preparation.reducer.theta.tolist(), preparation.reducer.noise_share],
        "spans": [vars(part) for part in preparation.spans],
        "channels": [part.config.model_dump(mode="json", exclude={"train"}) for part in recordings],
        "files": [file_stamp(str(path), path.parent) + str(path) for part in recordings for path in part.files],
    }
    if (choice := preparation.setup.calibration.terms) is not None:
        identity["terms"] = [TERMS.describe(part) for part in choice.terms]
    text = json.dumps(identity, default=str, sort_keys=True)
    return f"pieces-{sha256(text.encode()).hexdigest()[:12]}.parquet"


def reduce_pieces(
    preparation: PiecePlan, table: Path | None, executor: Executor | None = None, limits: Limits | None = None
) -> list[PieceFactors]:
    """Return all pieces in the order of their spans; those that ``table`` already holds are not reduced again.

    New pieces are kept in ``table``. Raises InputError where one cannot be reduced, once all others are.
    """
    piece_number = {span: k for k, span in enumerate(preparation.spans)}
    failures: list[tuple[Span, str]] = []
    with RowStore(table, _piece_schema(), KEY) as store:
        # pieces of an earlier run are taken from the table
        missing_spans = [span for span, k in piece_number.items() if (k,) not in store]
        for finished_job in run_jobs(preparation.reducer, missing_spans, executor, limits=limits):
            if finished_job.status is Status.OK and finished_job.value is not None:
                store.add([_piece_row(piece_number[finished_job.job], finished_job.value, finished_job.seconds)])
            else:
                failures.append((finished_job.job, finished_job.reason))
            report_progress(Step("reducing the pieces", len(store) + len(failures), len(piece_number)))
        if failures:
            # keep what is done, so that another run only repeats the failed pieces
            store.save()
            raise InputError(_failure_text(preparation, failures, table))
        rows = store.table().sort("piece").select("begins", "ends", *ARRAYS).iter_rows()
        return [
            PieceFactors(begins, ends, tuple(count), factors, (tuple(repeated), once, twice))
            for begins, ends, count, factors, repeated, once, twice in rows
        ]


def _failure_text(preparation: PiecePlan, failures: Sequence[tuple[Span, str]], table: Path | None) -> str:
    listed = sorted(failures, key=lambda failure: (failure[0].recording, failure[0].start))[:MAX_LISTED_FAILURES]
    label = preparation.reducer.recordings[listed[0][0].recording].label
    words = "; ".join(f"rows {span.start + 1} to {span.stop}: {reason}" for span, reason in listed)
    kept_note = "" if table is None else f" The others are kept in {table}."
    return f"{label}: {len(failures)} of {len(preparation.spans)} pieces could not be reduced ({words}).{kept_note}"


def _piece_schema() -> dict[str, Any]:
    import polars as pl

    numbers = {"piece": pl.Int64, "begins": pl.Float64, "ends": pl.Float64, "seconds": pl.Float64}
    counts = dict.fromkeys(("rows", "repeated_rows"), pl.List(pl.Int64))
    return {**numbers, **dict.fromkeys(ARRAYS, pl.Binary), **counts}


def _piece_row(piece: int, value: PieceFactors, seconds: float) -> Mapping[str, Any]:
    times = {"begins": value.begins, "ends": value.ends, "seconds": seconds}
    return {"piece": piece, **times, **dict(zip(ARRAYS, (value.rows, value.factors, *value.repetition), strict=True))}
