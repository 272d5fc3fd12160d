"""Recordings too long for the memory: Parquet files, planned by their footers and stamps, read a few rows at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.checks import GAP, MINIMUM_SAMPLES
from dynident.errors import ConfigError, InputError, Step, brief, memory
from dynident.identification import Stretch
from dynident.io.fields import Interval, unit_factor
from dynident.io.logs import log_of, without_excluded
from dynident.io.recording_parts import PARQUET, recording_parts
from dynident.io.settings import Config, LogSpec, check_joints
from dynident.io.signals import column_names
from dynident.io.tables import DAY, DataTable, count_rows, joined, read_rows
from dynident.log import Log
from dynident.models import Joint

__all__ = ["LongLog", "RecordedPart", "is_long", "long_logs"]

Array = NDArray[np.float64]
WEIGHT = 160  # bytes of memory per sample and joint that an identification takes where it holds all samples
CHUNK = 1_000_000  # stamps that are looked at together


@dataclass(frozen=True)
class RecordedPart:
    """A Parquet file of a recording, and the number of its rows."""

    path: Path
    rows: int


@dataclass(frozen=True, eq=False)
class LongLog:
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

    __repr__ = brief

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
        first = 0 if table.rows is None else int(table.rows[0])
        log, kept = log_of(table, self.config, self.joints, self.label)
        log = replace(log, t=log.t + self._late(rows.start, log, table))
        return without_excluded(log, self.config.train[0]), kept - first

    def _late(self, row: int, log: Log, table: DataTable) -> float:
        """Return what to add to the times (s) of a log from a row on, which are counted from another start."""
        time = self.config.time
        if time.rate is not None:
            return row / time.rate
        if table.units.get(time.column or "") != "s":
            return 0.0
        inside = next((one for one in self.stretches if one.start <= row < one.stop), None)
        expected = log.t[0] if inside is None else inside.begins + (row - inside.start) * self.step
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
        return joined(tables, f"{tables[0].source} from row {tables[0].place(0).removeprefix('row ')} on")

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
                if table.units.get(name) == "s" and t[0] < last:
                    t = t + DAY * np.ceil((last - t[0]) / DAY)
                self._check_stamps(table, name, t, last)
                yield at + start, t
                last = float(t[-1])
            at += part.rows

    def _check_stamps(self, table: DataTable, name: str, t: Array, last: float) -> None:
        bad = np.flatnonzero(~np.isfinite(t))
        if len(bad):
            raise InputError(
                f"{table.source}: column {name!r} has no valid time at {table.place(bad[0])} ({len(bad)} such rows); "
                "delete these rows."
            )
        if t[0] < last:
            raise InputError(
                f"{table.source}: begins at {t[0]:.9g} s, before the end of what precedes it ({last:.9g} s): the parts "
                f"of {self.label!r} must follow one another in the order of their names, and their time go on."
            )
        back = np.flatnonzero(np.diff(t) < 0)
        if len(back):
            raise InputError(
                f"{table.source}: column {name!r}: the time runs backwards at {table.place(back[0] + 1)} "
                f"({len(back)} such rows); sort the rows by time."
            )

    def planned(self, windows: Sequence[Interval], progress: Callable[[str], None]) -> LongLog:
        """Return the recording with the stretches of its rows in the windows (all of it, where there are none).

        Raises InputError where it has gaps that must not be split, or nothing is left.
        """
        found: list[Stretch] = []
        gaps: list[tuple[float, float]] = []
        last, inside, step, total = np.nan, -1, 0.0, len(self)
        for start, t in self.stamps():
            progress(Step(f"reading the times of {self.label}", start, total))
            if not step:
                steps = np.diff(t)
                step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
            window = _windows_of(t, windows)
            wide = np.diff(t, prepend=last) > GAP * step
            gaps += [(float(t[k - 1] if k else last), float(t[k])) for k in np.flatnonzero(wide)]
            fresh = wide | (np.diff(window, prepend=inside) != 0)
            edges = [0, *np.flatnonzero(fresh[1:]) + 1, len(t)]
            for a, b in pairwise(edges):
                if window[a] < 0:
                    continue
                if a == 0 and not fresh[0] and found:
                    found[-1] = replace(found[-1], stop=start + b, ends=float(t[b - 1]))
                else:
                    found.append(Stretch(start + a, start + b, float(t[a]), float(t[b - 1])))
            last, inside = float(t[-1]), int(window[-1])
        return self._with(found, gaps, step)

    def _with(self, found: list[Stretch], gaps: list[tuple[float, float]], step: float) -> LongLog:
        words = _gap_words(gaps, step)
        if gaps and self.config.gaps == "error":
            raise InputError(
                f"{self.label}: {words}; `gaps: split` fits what is between them, a `window` leaves them out."
            )
        kept = tuple(one for one in found if one.stop - one.start >= MINIMUM_SAMPLES)
        if not kept:
            raise InputError(f"{self.label}: nothing of the recording is left; look at its windows and gaps.")
        lost = sum(one.stop - one.start for one in found) - sum(one.stop - one.start for one in kept)
        notes = [f"{self.label}: {words}; no piece reaches over one."] if gaps else []
        notes += (
            [f"{self.label}: {lost} samples between gaps are too few to be smoothed, and left out."] if lost else []
        )
        return replace(self, stretches=kept, step=step, notes=tuple(notes))


def _gap_words(gaps: Sequence[tuple[float, float]], step: float) -> str:
    if not gaps:
        return ""
    start, stop = max(gaps, key=lambda one: one[1] - one[0])
    return (
        f"has {len(gaps)} gap{'s' * (len(gaps) > 1)}, the longest from {start:.9g} to {stop:.9g} s "
        f"({stop - start:.4g} s, where {step:.3g} s is usual)"
    )


def _windows_of(t: Array, windows: Sequence[Interval]) -> NDArray[Any]:
    """Return the place of the window that each time is in, -1 where there is none."""
    if not windows:
        return np.zeros(len(t), dtype=int)
    out = np.full(len(t), -1)
    for k, (start, stop) in enumerate(windows):
        out[(t >= (-np.inf if start is None else start)) & (t <= (np.inf if stop is None else stop))] = k
    return out


def is_long(config: Config) -> bool:
    """Return whether the training is more than the memory that a file may take; files are counted by their footers.

    Raises InputError where a Parquet file cannot be read.
    """
    files = {one for spec in config.train for path in spec.file.values() for one in recording_parts(path)}
    rows = sum(count_rows(one) for one in files if one.suffix.lower() == PARQUET and os.path.exists(one))
    return rows * len(config.position) * WEIGHT > memory()


def long_logs(
    config: Config, joints: Sequence[Joint], progress: Callable[[str], None] = lambda _: None
) -> tuple[LongLog, ...]:
    """Return the recordings of the training as they lie in their files.

    Raises ConfigError where the channels do not fit the joints, and InputError where a recording is no Parquet file, or
    its times cannot be used.
    """
    check_joints(config, joints)
    opened = partial(_opened, config=config, joints=tuple(joints), progress=progress)
    return tuple(map(opened, config.train))


def _opened(spec: LogSpec, config: Config, joints: tuple[Joint, ...], progress: Callable[[str], None]) -> LongLog:
    files = [one.absolute() for path in spec.file.values() for one in recording_parts(path)]
    other = next((one for one in files if one.suffix.lower() != PARQUET), None)
    if other is not None or list(spec.file) != [""]:
        raise InputError(
            f"{spec.label}: the recordings of `train` are too long for the memory, and {other or 'this one'} cannot be "
            "read in pieces: write all of its columns to Parquet files, choose a shorter `window` of a shorter file, "
            "or raise the memory by --memory."
        )
    if any(config.position[joint.name].wraps for joint in joints):
        raise ConfigError(
            "position: `wraps` is not known to recordings that are read in pieces, which would not agree on the turn: "
            "write the positions as they go on, for example by numpy.unwrap."
        )
    channels = config.model_copy(
        update={
            "train": (spec,),
            "validation": (),
            "model": "",
            "smoother": None,
            "estimator": None,
            "simulation": None,
        }
    )
    parts = tuple(RecordedPart(one, count_rows(one)) for one in files)
    return LongLog(spec.label, channels, joints, parts).planned(spec.window, progress)
