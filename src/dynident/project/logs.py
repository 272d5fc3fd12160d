"""Measured logs: the declared channels of a file, in SI units, cut into windows and checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.checks import MINIMUM_SAMPLES, check_log, respace, rest_findings, split_gaps
from dynident.checks.motion_notes import LoopUnused
from dynident.files.tables import DataTable, read_columns
from dynident.models import Joint
from dynident.models.simulation import HasTimes
from dynident.motion.log import Log
from dynident.project.columns import is_reference
from dynident.project.drive_settings import LoopSettings, ServoSettings
from dynident.project.fields import Interval, interval_ends, interval_words
from dynident.project.settings import Config, LogSpec, check_joints
from dynident.project.signals import RecordedSignals, bad_values, column_names, controller, has_torques, signals
from dynident.runtime import (
    ConfigError,
    Finding,
    InputError,
    Note,
    Remark,
    Severity,
    brief,
    choices,
    count,
    report_progress,
    require,
)
from dynident.runtime.arrays import Array

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


class _RecordingCache:
    """Reads each recording once, of which several parts are used; it is forgotten after the last of them."""

    def __init__(self, specs: Sequence[LogSpec]) -> None:
        self._left = Counter(map(self._key, specs))
        self._tables: dict[str, tuple[Collection[str], DataTable]] = {}

    def __call__(self, spec: LogSpec, needed: Collection[str]) -> DataTable:
        """Return the table of a recording, as ``read_recording`` does."""
        key = self._key(spec)
        self._left[key] -= 1
        # a table that was read for other columns cannot serve this part
        cached_columns, table = self._tables.pop(key, (None, None))
        if table is None or cached_columns != needed:
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
    reading = read_unchecked(spec, config, joints, read or read_recording, torque=torque)
    warnings = list(reading.warnings)
    for piece in reading.logs:
        findings = _findings_of_log(piece, config, joints, ", ".join(map(str, spec.file.values())), reading.measured)
        warnings += [
            str(replace(finding, source=piece.source)) for finding in findings if finding.severity is Severity.WARNING
        ]
    return replace(reading, warnings=tuple(warnings))


def read_roles(config: Config, joints: Sequence[Joint]) -> tuple[dict[str, dict[str, Log]], tuple[str, ...]]:
    """Read all recordings of a configuration: their logs by role ("train", "validation") and name, and warnings.

    Raises the errors of ``read_logs``, and ConfigError where two logs of a role have the same name.
    """
    logs: dict[str, dict[str, Log]] = {"train": {}, "validation": {}}
    warnings: list[str] = []
    read = _RecordingCache([*config.train, *config.validation])
    for role, spec in _specs_by_role(config):
        reading = read_logs(spec, config, joints, read=read)
        for log in reading.logs:
            if log.source in logs[role]:
                raise ConfigError(f"{role}: two logs are called {log.source!r}; give one of them another `name`.")
            logs[role][log.source] = log
        warnings += reading.warnings
    return logs, tuple(warnings)


def _specs_by_role(config: Config) -> Iterator[tuple[str, LogSpec]]:
    """Yield all recordings with their role, each once it is to be read."""
    for role in ("train", "validation"):
        for spec in getattr(config, role):
            report_progress(f"reading {spec.label}")
            yield role, spec


def read_with_findings(
    config: Config, joints: Sequence[Joint]
) -> tuple[dict[str, dict[str, Log]], tuple[Finding, ...]]:
    """Read all recordings as ``read_roles`` does, without checks: one that cannot be read is a finding, and left out.

    Raises ConfigError where the channels do not fit the joints.
    """
    check_joints(config, joints)
    logs: dict[str, dict[str, Log]] = {"train": {}, "validation": {}}
    findings: list[Finding] = []
    references: list[str] = []
    read = _RecordingCache([*config.train, *config.validation])
    for role, spec in _specs_by_role(config):
        try:
            reading = read_unchecked(spec, config, joints, read)
        except InputError as error:
            findings.append(Finding(Remark(str(error)), source=spec.label, severity=Severity.ERROR))
            continue
        logs[role].update({log.source: log for log in reading.logs})
        findings += [Finding(Remark(text)) for text in reading.warnings]
        references += [name for name in reading.unused if is_reference(name, config.position)]
    # columns that look like references, left unused, mean that the loop could be simulated but is not
    if references and not isinstance(config.simulation, LoopSettings):
        findings.append(Finding(LoopUnused(tuple(dict.fromkeys(references)))))
    return logs, tuple(findings)


def read_unchecked(
    spec: LogSpec,
    config: Config,
    joints: Sequence[Joint],
    read: Callable[[LogSpec, Collection[str]], DataTable],
    *,
    torque: bool = True,
) -> Reading:
    """Read one recording as ``read_logs`` does, without checking its logs."""
    check_joints(config, joints)
    if torque and isinstance(config.simulation, ServoSettings):
        raise ConfigError(
            "simulation: logs of servos have no torque, which this needs; use `dynident identify` or `dynident check`, "
            "in Python `dy.identify_servos`."
        )
    table = read(spec, column_names(config, spec))
    recording = signals(table, config, joints, measured=torque or has_torques(table, config, joints))
    drive = controller(recording, config.simulation, spec, joints) if torque else None
    logs: list[Log] = []
    warnings = [f"{spec.label}: {note}" for note in recording.table.notes]
    # each window is a log of its own; gaps may divide it further
    for window in spec.window or ((None, None),):
        name = spec.label if len(spec.window) < 2 else f"{spec.label} {interval_words(window)}"
        log = _cut_window(recording, window, joints, name)
        pieces = _split_log(replace(log, controller=drive), config.gaps, recording.table.source)
        warnings += [*_overhang_warnings(name, recording.t, window), *_left_out_warnings(log, pieces)]
        for piece in pieces:
            # spacing is judged in each piece, once gaps are out
            spaced, note = _respace_log(piece, config.time.spacing)
            logs.append(without_excluded(spaced, spec))
            warnings += [] if note is None else [f"{piece.source}: {note}"]
    warnings += _exclusion_warnings(spec, logs)
    unused = tuple(name for name in (*table.columns, *table.unread) if name not in column_names(config, spec))
    return Reading(tuple(logs), tuple(warnings), recording.measured, unused)


def without_excluded(log: Log, spec: LogSpec) -> Log:
    """Return a log with the samples excluded that its recording names."""
    return log.exclude(map(interval_ends, spec.exclude))


def _exclusion_warnings(spec: LogSpec, logs: Sequence[Log]) -> Iterator[str]:
    """Yield a warning for each window in which nothing is to be excluded."""
    for window in spec.exclude:
        start, stop = interval_ends(window)
        if not any(((log.t >= start) & (log.t <= stop)).any() for log in logs):
            yield (
                f"{spec.label}: there is no sample to exclude in {interval_words(window)}; "
                f"what is used runs from {logs[0].t[0]:.6g} to {logs[-1].t[-1]:.6g} s."
            )


def log_of(table: DataTable, config: Config, joints: Sequence[Joint], name: str) -> tuple[Log, NDArray[np.intp]]:
    """Return the log of all rows of a table, between which there is no gap, and which rows these are after repetitions
    are left out; raises as ``read_logs``."""
    config = config.model_copy(update={"gaps": "error"})  # rows that are left out would be gaps
    recording = signals(table, config, joints, measured=True)
    rows = np.arange(len(recording.t)) if recording.table.rows is None else recording.table.rows
    return _respace_log(_cut_window(recording, (None, None), joints, name), config.time.spacing)[0], rows


def read_recording(spec: LogSpec, needed: Collection[str] | None = None) -> DataTable:
    """Return the table of a recording; where it has several files, their columns are named ``key.column``.

    ``needed`` as in ``read_columns``.

    Raises InputError where one of them cannot be read.
    """
    tables = {}
    for key, path in spec.file.items():
        width = spec.width.get(key) if isinstance(spec.width, Mapping) else spec.width
        tables[key] = read_columns(path, width, _columns_of_file(key, needed))
    if list(tables) == [""]:
        return tables[""]
    return DataTable(
        _prefix_names({key: table.columns for key, table in tables.items()}),
        _prefix_names({key: table.constants for key, table in tables.items()}),
        ", ".join(f"{key}: {table.source}" for key, table in tables.items()),
        _prefix_names({key: table.faults for key, table in tables.items()}),
        notes=tuple(note for table in tables.values() for note in table.notes),
        unread=tuple(f"{key}.{name}" for key, table in tables.items() for name in table.unread),
        units=_prefix_names({key: table.units for key, table in tables.items()}),
        guesses=tuple(guess for table in tables.values() for guess in table.guesses),
    )


def _columns_of_file(key: str, needed: Collection[str] | None) -> Collection[str] | None:
    """Return the names of one file's columns among those of a recording."""
    if needed is None or not key:
        return needed
    return {name.removeprefix(f"{key}.") for name in needed if name.startswith(f"{key}.")}


def _prefix_names(parts: Mapping[str, Mapping[str, T]]) -> dict[str, T]:
    return {f"{key}.{name}": entry for key, part in parts.items() for name, entry in part.items()}


def _cut_window(recording: RecordedSignals, window: Interval, joints: Sequence[Joint], name: str) -> Log:
    """Return the log of one window; values outside it need not be finite."""
    start, stop = interval_ends(window)
    t, source = recording.t, recording.table.source
    rows = np.flatnonzero((t >= start) & (t <= stop))
    if len(rows) < 2:
        raise InputError(
            f"{source}: the window {interval_words(window)} holds {count(len(rows), 'sample')}; "
            f"the recording runs from {t[0]:.12g} to {t[-1]:.12g} s. Correct the window, or the `unit` of `time`."
        )
    part = slice(int(rows[0]), int(rows[-1]) + 1)  # the stamps increase
    # only samples inside the window must be finite; the first bad one is named
    bad_rows = {column: rows[bad_values(values[part])] for column, values in recording.columns.items()}
    for column, bad in bad_rows.items():
        if len(bad):
            if len(bad) == len(rows):
                raise InputError(
                    f"{source}: column {column!r} holds no number from {t[rows[0]]:.15g} to {t[rows[-1]]:.15g} s. "
                    "Is the right column named, and was it recorded? A joint whose torque was not can be fitted "
                    "around: write zeros in its place."
                )
            value = recording.columns[column][bad[0]]
            fault, remedy = f"{value:.3g}", ""
            if np.isnan(value):
                fault, remedy = "empty or NaN", ", or where rows have stamps by `gaps: split`"
            bad_count = count(len(set().union(*bad_rows.values())), "such row")
            raise InputError(
                f"{source}: column {column!r} is {fault} at {recording.table.place(bad[0])} ({bad_count} in all, "
                f"of any column). Correct these samples, or leave them out by a window{remedy}."
            )
    return Log(t[part], recording.q[part], recording.tau[part], tuple(joint.name for joint in joints), name)


def _split_log(log: Log, gaps: str, source: str) -> tuple[Log, ...]:
    pieces = split_gaps(log) if gaps == "split" else (log,)
    if not pieces:
        raise InputError(f"{source}: the gaps in {log.source!r} leave no piece long enough; widen the window.")
    return pieces


def _respace_log(log: Log, spacing: str) -> tuple[Log, Note | None]:
    """Return the log, and the signals of its controller, at the times at which they were sampled."""
    if spacing == "stamps":
        return log, None
    spaced, note = respace(log, always=spacing == "even")
    if isinstance(drive := log.controller, HasTimes):
        # references before the first or after the last stamp keep their distance to it
        beyond = drive.t - np.clip(drive.t, log.t[0], log.t[-1])
        spaced = replace(spaced, controller=drive.timed(np.interp(drive.t, log.t, spaced.t) + beyond))
    return spaced, note


def _findings_of_log(
    log: Log, config: Config, joints: Sequence[Joint], source: str, measured: bool
) -> tuple[Finding, ...]:
    """Return the findings on a log; InputError where one of them is an error."""
    findings = check_log(log, {joint.name: joint.kind for joint in joints}, turning_joints(config), torque=measured)
    require(findings, f"{source} ({log.source})")
    # rests are trimmed by default; those that stay in the fit are worth a finding
    keeps_rests = config.rests == "keep" and config.min_speed is None and len(log) >= MINIMUM_SAMPLES
    return (*findings, *rest_findings(log, rests_kept=True)) if keeps_rests else findings


def turning_joints(config: Config) -> frozenset[str]:
    """Return the joints whose large angles do not indicate degrees declared as radians."""
    return frozenset(name for name, channel in config.position.items() if channel.multi_turn or channel.unit != "rad")


def _overhang_warnings(name: str, t: Array, window: Interval) -> Iterator[str]:
    """Yield a warning where a window extends beyond the recording by more than a sample."""
    step = float(np.median(np.diff(t)))
    start, stop = window
    if (start is not None and start < t[0] - step) or (stop is not None and stop > t[-1] + step):
        yield (
            f"{name}: the window {interval_words(window)} extends beyond the recording, "
            f"which runs from {t[0]:.6g} to {t[-1]:.6g} s."
        )


def _left_out_warnings(log: Log, pieces: Sequence[Log]) -> Iterator[str]:
    lost = len(log) - sum(map(len, pieces))
    if lost:
        yield f"{log.source}: {lost} samples are left out, in pieces between gaps too short to be smoothed."


def log_spec(text: str, config: Config) -> LogSpec:
    """Return the recording named on a command line: a file, or ``key=file,key=file`` as the configuration has keys.

    Widths of text files are those of the training log. Raises ConfigError where keys are missing or unknown.
    """
    training_log = config.train[0]
    keys = list(training_log.file)
    if keys == [""]:
        if not text.strip():
            raise ConfigError("the name of a recording is empty; give a file.")
        return LogSpec.model_validate({"file": text, "width": training_log.width})
    pairs = _files_by_key(text, keys, _needed_keys(config, keys))
    width = training_log.width
    if isinstance(width, Mapping):
        width = {key: count for key, count in width.items() if key in pairs}
    return LogSpec.model_validate({"file": pairs, "width": width})


def recording_argument(spec: LogSpec) -> str:
    """Return the text by which a command line names a recording, with files below the current folder relative to it."""
    here = Path.cwd()
    files = ((key, file.relative_to(here) if file.is_relative_to(here) else file) for key, file in spec.file.items())
    return ",".join(f"{key}={file}" if key else str(file) for key, file in files)


def recording_of(log: str, specs: Sequence[LogSpec]) -> LogSpec | None:
    """Return the recording that a log is, or a window or a piece of, by its name; None where there is none."""
    matches = [spec for spec in specs if log == spec.label or log.startswith(f"{spec.label} ")]
    # one label may be the beginning of another: the longest match is the recording
    return max(matches, key=lambda spec: len(spec.label), default=None)


def _files_by_key(text: str, keys: list[str], needed: list[str]) -> dict[str, str]:
    """Return the files by key of ``key=file,key=file``; ConfigError where one is unknown or missing."""
    pairs = dict(part.partition("=")[::2] for part in text.split(","))
    for key in pairs:
        if key not in keys:
            raise ConfigError(
                f"{text}: no file is called {key!r}; {choices(key, keys)} Write such as {_example_argument(keys)}."
            )
    missing = [key for key in {**dict.fromkeys(needed), **pairs} if not pairs.get(key, "").strip()]
    if missing:
        raise ConfigError(f"{text}: the file {missing[0]!r} is missing; write such as {_example_argument(keys)}.")
    return pairs


def _needed_keys(config: Config, keys: list[str]) -> list[str]:
    """Return the keys of files that hold times or positions."""
    names = [name for channel in config.position.values() for name in channel.terms]
    names += [config.time.column] if config.time.column else []
    return [key for key in keys if any(name.startswith(f"{key}.") for name in names)]


def _example_argument(keys: list[str]) -> str:
    return ",".join(f"{key}=FILE" for key in keys)
