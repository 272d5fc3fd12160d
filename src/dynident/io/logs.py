"""Measured logs: the declared channels of a file, in SI units, cut into windows and checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.checks import (
    MINIMUM_SAMPLES,
    Finding,
    Topic,
    check_log,
    reading_line,
    reading_words,
    require,
    respaced,
    rest,
    split_gaps,
)
from dynident.checks.motion_notes import LoopUnused
from dynident.errors import ConfigError, InputError, Note, Severity, brief
from dynident.io.columns import is_reference
from dynident.io.controllers import controller
from dynident.io.fields import Interval, interval_words
from dynident.io.settings import Config, LogSpec, check_joints
from dynident.io.signals import RecordedSignals, bad_values, column_names, has_torques, signals
from dynident.io.simulation_settings import LoopSettings
from dynident.io.tables import DataTable, read_columns
from dynident.log import Log
from dynident.models import Joint
from dynident.simulation import HasTimes

__all__ = [
    "DataTable",
    "Reading",
    "log_of",
    "read_columns",
    "read_found",
    "read_logs",
    "read_recording",
    "read_roles",
    "turning_joints",
    "without_excluded",
]

Array = NDArray[np.float64]
T = TypeVar("T")


@dataclass(frozen=True)
class Reading:
    """The logs of a recording, one per window or uninterrupted piece, warnings, and the ``unused`` columns.

    Where it is not ``measured``, there are no torques, and those of the logs are zero.
    """

    logs: tuple[Log, ...]
    warnings: tuple[str, ...] = ()
    measured: bool = True
    unused: tuple[str, ...] = ()

    __repr__ = brief


class _Recordings:
    """Reads each recording once, of which several parts are used; it is forgotten after the last of them."""

    def __init__(self, specs: Sequence[LogSpec]) -> None:
        self._left = Counter(map(self._key, specs))
        self._tables: dict[str, tuple[Collection[str], DataTable]] = {}

    def __call__(self, spec: LogSpec, needed: Collection[str]) -> DataTable:
        """Return the table of a recording, as ``read_recording`` does."""
        key = self._key(spec)
        self._left[key] -= 1
        known, table = self._tables.pop(key, (None, None))
        if table is None or known != needed:
            table = read_recording(spec, needed)
        if self._left[key] > 0:
            self._tables[key] = needed, table
        return table

    @staticmethod
    def _key(spec: LogSpec) -> str:
        return repr((spec.file, spec.width))


def read_logs(
    spec: LogSpec,
    config: Config,
    joints: Sequence[Joint],
    *,
    torque: bool = True,
    read: Callable[[LogSpec, Collection[str]], DataTable] | None = None,
) -> Reading:
    """Read one recording of the configuration, for the joints of the model and in their order.

    The logs have t in s, q in rad or m, tau in N m or N. Where ``torque`` is False, the recording need not have the
    columns of the torques: it may lack all of them. ``read`` is ``read_recording``, or in its place. Raises ConfigError
    where the channels do not fit the joints, and
    InputError, with file, line and column, where the data cannot be used.
    """
    reading = _read(spec, config, joints, read or read_recording, torque=torque)
    warnings = list(reading.warnings)
    for piece in reading.logs:
        findings = _checked(piece, config, joints, ", ".join(map(str, spec.file.values())), reading.measured)
        warnings += [
            f"{piece.source}: {reading_line(found)}" for found in findings if found.severity is Severity.WARNING
        ]
    return replace(reading, warnings=tuple(warnings))


def read_roles(
    config: Config, joints: Sequence[Joint], progress: Callable[[str], None] = lambda _: None
) -> tuple[dict[str, dict[str, Log]], tuple[str, ...]]:
    """Read all recordings of a configuration: their logs by role ("train", "validation") and name, and warnings.

    Raises the errors of ``read_logs``, and ConfigError where two logs of a role have the same name.
    """
    logs: dict[str, dict[str, Log]] = {"train": {}, "validation": {}}
    warnings: list[str] = []
    read = _Recordings([*config.train, *config.validation])
    for role, found in logs.items():
        for spec in getattr(config, role):
            progress(f"reading {spec.label}")
            reading = read_logs(spec, config, joints, read=read)
            for log in reading.logs:
                if log.source in found:
                    raise ConfigError(f"{role}: two logs are called {log.source!r}; give one of them another `name`.")
                found[log.source] = log
            warnings += reading.warnings
    return logs, tuple(warnings)


def read_found(
    config: Config, joints: Sequence[Joint], progress: Callable[[str], None] = lambda _: None
) -> tuple[dict[str, dict[str, Log]], tuple[Finding, ...]]:
    """Read all recordings as ``read_roles`` does, without checks: one that cannot be read is a finding, and left out.

    Raises ConfigError where the channels do not fit the joints.
    """
    check_joints(config, joints)
    logs: dict[str, dict[str, Log]] = {"train": {}, "validation": {}}
    findings: list[Finding] = []
    references: list[str] = []
    read = _Recordings([*config.train, *config.validation])
    for role, found in logs.items():
        for spec in getattr(config, role):
            progress(f"reading {spec.label}")
            try:
                reading = _read(spec, config, joints, read)
            except InputError as error:
                findings.append(Finding(Severity.ERROR, None, str(error), source=spec.label))
                continue
            found.update({log.source: log for log in reading.logs})
            findings += [Finding(Severity.WARNING, None, words) for words in reading.warnings]
            references += [name for name in reading.unused if is_reference(name, config.position)]
    if references and not isinstance(config.simulation, LoopSettings):
        findings.append(Finding(Severity.INFO, None, LoopUnused(tuple(dict.fromkeys(references))), Topic.LOOP))
    return logs, tuple(findings)


def _read(
    spec: LogSpec,
    config: Config,
    joints: Sequence[Joint],
    read: Callable[[LogSpec, Collection[str]], DataTable],
    *,
    torque: bool = True,
) -> Reading:
    """Read one recording as ``read_logs`` does, without checking its logs."""
    check_joints(config, joints)
    table = read(spec, column_names(config, spec))
    found = signals(table, config, joints, measured=torque or has_torques(table, config, joints))
    drive = controller(found, config.simulation, spec, joints) if torque else None
    logs: list[Log] = []
    warnings = [f"{spec.label}: {note}" for note in found.table.notes]
    for window in spec.window or ((None, None),):
        name = spec.label if len(spec.window) < 2 else f"{spec.label} {interval_words(window)}"
        log = _cut(found, window, joints, name)
        pieces = _pieces(replace(log, controller=drive), config.gaps, found.table.source)
        warnings += [*_overhang(name, found.t, window), *_left_out(log, pieces)]
        for piece in pieces:
            spaced, note = _spaced(piece, config.time.spacing)
            logs.append(without_excluded(spaced, spec))
            warnings += [] if note is None else [f"{piece.source}: {reading_words(note)}"]
    warnings += _excluded_nothing(spec, logs)
    unused = tuple(name for name in (*table.columns, *table.unread) if name not in column_names(config, spec))
    return Reading(tuple(logs), tuple(warnings), found.measured, unused)


def without_excluded(log: Log, spec: LogSpec) -> Log:
    """Return a log with the samples excluded that its recording names."""
    return log.excluding((-np.inf if a is None else a, np.inf if b is None else b) for a, b in spec.exclude)


def _excluded_nothing(spec: LogSpec, logs: Sequence[Log]) -> Iterator[str]:
    """Yield a warning for each window in which nothing is to be excluded."""
    for window in spec.exclude:
        start, stop = (-np.inf if window[0] is None else window[0], np.inf if window[1] is None else window[1])
        if not any(((log.t >= start) & (log.t <= stop)).any() for log in logs):
            yield (
                f"{spec.label}: there is no sample to exclude in {interval_words(window)}; "
                f"what is used runs from {logs[0].t[0]:.6g} to {logs[-1].t[-1]:.6g} s."
            )


def log_of(table: DataTable, config: Config, joints: Sequence[Joint], name: str) -> tuple[Log, NDArray[np.intp]]:
    """Return the log of all rows of a table, between which there is no gap, and which rows these are after repetitions
    are left out; raises as ``read_logs``."""
    found = signals(table, config, joints, measured=True)
    rows = np.arange(len(found.t)) if found.table.rows is None else found.table.rows
    return _spaced(_cut(found, (None, None), joints, name), config.time.spacing)[0], rows


def read_recording(spec: LogSpec, needed: Collection[str] | None = None) -> DataTable:
    """Return the table of a recording; where it has several files, their columns are named ``key.column``.

    ``needed`` as in ``read_columns``.

    Raises InputError where one of them cannot be read.
    """
    tables = {
        key: read_columns(
            path, spec.width.get(key) if isinstance(spec.width, Mapping) else spec.width, _of(key, needed)
        )
        for key, path in spec.file.items()
    }
    if list(tables) == [""]:
        return tables[""]
    return DataTable(
        _keyed({key: table.columns for key, table in tables.items()}),
        _keyed({key: table.constants for key, table in tables.items()}),
        ", ".join(f"{key}: {table.source}" for key, table in tables.items()),
        _keyed({key: table.faults for key, table in tables.items()}),
        notes=tuple(note for table in tables.values() for note in table.notes),
        unread=tuple(f"{key}.{name}" for key, table in tables.items() for name in table.unread),
        units=_keyed({key: table.units for key, table in tables.items()}),
        guesses=tuple(guess for table in tables.values() for guess in table.guesses),
    )


def _of(key: str, needed: Collection[str] | None) -> Collection[str] | None:
    """Return the names of one file's columns among those of a recording."""
    if needed is None or not key:
        return needed
    return {name.removeprefix(f"{key}.") for name in needed if name.startswith(f"{key}.")}


def _keyed(parts: Mapping[str, Mapping[str, T]]) -> dict[str, T]:
    return {f"{key}.{name}": one for key, part in parts.items() for name, one in part.items()}


def _cut(found: RecordedSignals, window: Interval, joints: Sequence[Joint], name: str) -> Log:
    """Return the log of one window; values outside it need not be finite."""
    start, stop = (-np.inf if window[0] is None else window[0], np.inf if window[1] is None else window[1])
    t, source = found.t, found.table.source
    rows = np.flatnonzero((t >= start) & (t <= stop))
    if len(rows) < 2:
        raise InputError(
            f"{source}: the window {interval_words(window)} holds {len(rows)} samples; "
            f"the recording runs from {t[0]:.12g} to {t[-1]:.12g} s. Correct the window, or the `unit` of `time`."
        )
    part = slice(int(rows[0]), int(rows[-1]) + 1)  # the stamps increase
    for column, values in found.used.items():
        bad = rows[bad_values(values[part])]
        if len(bad):
            if len(bad) == len(rows):
                raise InputError(
                    f"{source}: column {column!r} holds no number from {t[rows[0]]:.15g} to {t[rows[-1]]:.15g} s. "
                    "Is the right column named, and was it recorded? A joint whose torque was not can be fitted "
                    "around: write zeros in its place."
                )
            value = values[bad[0]]
            what = "empty or NaN" if np.isnan(value) else f"{value:.3g}"
            raise InputError(
                f"{source}: column {column!r} is {what} at {found.table.place(bad[0])} "
                f"({len(bad)} such values in all). Correct these samples, or leave them out with a window."
            )
    return Log(t[part], found.q[part], found.tau[part], tuple(joint.name for joint in joints), name)


def _pieces(log: Log, gaps: str, source: str) -> tuple[Log, ...]:
    pieces = split_gaps(log) if gaps == "split" else (log,)
    if not pieces:
        raise InputError(f"{source}: the gaps in {log.source!r} leave no piece long enough; widen the window.")
    return pieces


def _spaced(log: Log, spacing: str) -> tuple[Log, Note | None]:
    """Return the log, and what drove it, at the times at which it was sampled."""
    if spacing == "stamps":
        return log, None
    spaced, note = respaced(log, always=spacing == "even")
    if isinstance(drive := log.controller, HasTimes):
        beyond = drive.t - np.clip(drive.t, log.t[0], log.t[-1])
        spaced = replace(spaced, controller=drive.timed(np.interp(drive.t, log.t, spaced.t) + beyond))
    return spaced, note


def _checked(log: Log, config: Config, joints: Sequence[Joint], source: str, measured: bool) -> tuple[Finding, ...]:
    """Return the findings on a log; InputError where one of them is an error."""
    findings = check_log(log, {joint.name: joint.kind for joint in joints}, turning_joints(config), torque=measured)
    require(findings, f"{source} ({log.source})")
    kept = config.rests == "keep" and config.min_speed is None and len(log) >= MINIMUM_SAMPLES
    return (*findings, *rest(log, kept=True)) if kept else findings


def turning_joints(config: Config) -> frozenset[str]:
    """Return the joints whose large angles do not indicate degrees declared as radians."""
    return frozenset(name for name, channel in config.position.items() if channel.multi_turn or channel.unit != "rad")


def _overhang(name: str, t: Array, window: Interval) -> Iterator[str]:
    """Yield a warning where a window extends beyond the recording by more than a sample."""
    step = float(np.median(np.diff(t)))
    start, stop = window
    if (start is not None and start < t[0] - step) or (stop is not None and stop > t[-1] + step):
        yield (
            f"{name}: the window {interval_words(window)} extends beyond the recording, "
            f"which runs from {t[0]:.6g} to {t[-1]:.6g} s."
        )


def _left_out(log: Log, pieces: Sequence[Log]) -> Iterator[str]:
    lost = len(log) - sum(map(len, pieces))
    if lost:
        yield f"{log.source}: {lost} samples are left out, in pieces between gaps too short to be smoothed."
