"""Measured logs: the declared channels of a file, in SI units, cut into windows and checked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.control import CascadePD
from dynident.diagnostics import Finding, check, require, split_gaps
from dynident.errors import ConfigError, InputError
from dynident.io.fields import Interval, interval_words, unit_factor
from dynident.io.settings import POSITIONS, TORQUES, CascadeSettings, Channel, Config, LogSpec, check_joints
from dynident.io.tables import Table, read_columns
from dynident.log import Log
from dynident.terms.term import Joint

__all__ = [
    "Reading",
    "Table",
    "read_columns",
    "read_found",
    "read_logs",
    "read_recording",
    "read_roles",
    "turning_joints",
]

Array = NDArray[np.float64]

_LARGEST = 1e100  # beyond it a value is damaged, and its square may overflow


@dataclass(frozen=True)
class Reading:
    """What a recording gave: its logs, one per window or uninterrupted piece, and warnings in words.

    Where it is not ``measured``, there are no torques, and those of the logs are zero.
    """

    logs: tuple[Log, ...]
    warnings: tuple[str, ...] = ()
    measured: bool = True


@dataclass(frozen=True, eq=False)
class _Signals:
    """All rows of a recording: t (N) s, q and tau (N, n) in SI, and the columns they come from."""

    table: Table
    used: Mapping[str, Array]
    t: Array
    q: Array
    tau: Array
    measured: bool


def read_logs(spec: LogSpec, config: Config, joints: Sequence[Joint], *, torque: bool = True) -> Reading:
    """Read one recording of the configuration, for the joints of the model and in their order.

    The logs have t in s, q in rad or m, tau in N m or N. Where ``torque`` is False, the recording need not have the
    columns of the torques: it may lack all of them. Raises ConfigError where the channels do not fit the joints, and
    InputError, with file, line and column, where the data cannot be used.
    """
    reading = _read(spec, config, joints, torque=torque)
    warnings = list(reading.warnings)
    for piece in reading.logs:
        findings = _checked(piece, config, joints, ", ".join(map(str, spec.file.values())), reading.measured)
        warnings += [f"{piece.source}: {found}" for found in findings if found.severity == "warning"]
    return replace(reading, warnings=tuple(warnings))


def read_roles(
    config: Config, joints: Sequence[Joint], progress: Callable[[str], None] = lambda _: None
) -> tuple[dict[str, dict[str, Log]], tuple[str, ...]]:
    """Read all recordings of a configuration: their logs by role ("train", "validation") and name, and warnings.

    Raises the errors of ``read_logs``, and ConfigError where two logs of a role have the same name.
    """
    logs: dict[str, dict[str, Log]] = {"train": {}, "validation": {}}
    warnings: list[str] = []
    for role, found in logs.items():
        for spec in getattr(config, role):
            progress(f"reading {spec.label}")
            reading = read_logs(spec, config, joints)
            for log in reading.logs:
                if log.source in found:
                    raise ConfigError(f"{role}: two logs are called {log.source!r}; give one of them another `name`.")
                found[log.source] = log
            warnings += reading.warnings
    return logs, tuple(warnings)


def read_found(
    config: Config, joints: Sequence[Joint], progress: Callable[[str], None] = lambda _: None
) -> tuple[dict[str, dict[str, Log]], tuple[Finding, ...]]:
    """Read all recordings as ``read_roles`` does, but judge none: what cannot be read is a finding, and goes missing.

    Raises ConfigError where the channels do not fit the joints.
    """
    check_joints(config, joints)
    logs: dict[str, dict[str, Log]] = {"train": {}, "validation": {}}
    findings: list[Finding] = []
    for role, found in logs.items():
        for spec in getattr(config, role):
            progress(f"reading {spec.label}")
            try:
                reading = _read(spec, config, joints)
            except InputError as error:
                findings.append(Finding("error", None, str(error), source=spec.label))
                continue
            found.update({log.source: log for log in reading.logs})
            findings += [Finding("warning", None, words) for words in reading.warnings]
    return logs, tuple(findings)


def _read(spec: LogSpec, config: Config, joints: Sequence[Joint], *, torque: bool = True) -> Reading:
    """Read one recording as ``read_logs`` does, but do not judge its logs."""
    check_joints(config, joints)
    table = read_recording(spec)
    signals = _signals(table, config, joints, measured=torque or _has_torques(table, config, joints))
    controller = _controller(signals, config.simulation, spec, joints) if torque else None
    logs: list[Log] = []
    warnings = [f"{spec.label}: {note}" for note in table.notes]
    for window in spec.window or ((None, None),):
        name = spec.label if len(spec.window) < 2 else f"{spec.label} {interval_words(window)}"
        log = _cut(signals, window, joints, name)
        pieces = _pieces(replace(log, controller=controller), config.gaps, signals.table.source)
        warnings += [*_overhang(name, signals.t, window), *_left_out(log, pieces)]
        logs += pieces
    return Reading(tuple(logs), tuple(warnings), signals.measured)


def read_recording(spec: LogSpec) -> Table:
    """Return the table of a recording; where it has several files, their columns are named ``key.column``.

    Raises InputError where one of them cannot be read.
    """
    tables = {
        key: read_columns(path, spec.width.get(key) if isinstance(spec.width, Mapping) else spec.width)
        for key, path in spec.file.items()
    }
    if list(tables) == [""]:
        return tables[""]
    return Table(
        {f"{key}.{name}": column for key, table in tables.items() for name, column in table.columns.items()},
        {f"{key}.{name}": value for key, table in tables.items() for name, value in table.constants.items()},
        ", ".join(f"{key}: {table.source}" for key, table in tables.items()),
        {f"{key}.{name}": fault for key, table in tables.items() for name, fault in table.faults.items()},
        notes=tuple(note for table in tables.values() for note in table.notes),
    )


def _has_torques(table: Table, config: Config, joints: Sequence[Joint]) -> bool:
    """Whether the table has any column of a torque."""
    known = {*table.columns, *table.constants, *table.faults}
    return any(name in known for joint in joints for name in config.torque[joint.name].terms)


def _signals(table: Table, config: Config, joints: Sequence[Joint], *, measured: bool) -> _Signals:
    used = _used(table, config, joints, measured=measured)
    rows = len(next(iter(used.values())))
    q: Array = _matrix(table, config.position, joints, "position", POSITIONS)
    tau = _matrix(table, config.torque, joints, "torque", TORQUES) if measured else np.zeros(q.shape)
    if config.transmission:
        gears = _transmission(config, joints)
        with np.errstate(over="ignore", invalid="ignore"):
            q, tau = np.asarray(np.linalg.solve(gears, q.T).T, dtype=float), tau @ gears
    q = q + np.array([config.zero.get(joint.name, 0.0) for joint in joints])
    return _Signals(table=table, used=used, t=_times(table, config, rows), q=q, tau=tau, measured=measured)


def _controller(signals: _Signals, settings: object, spec: LogSpec, joints: Sequence[Joint]) -> CascadePD | None:
    """Return the controller that drove a recording, with its references and its gains; InputError where they lack."""
    if not isinstance(settings, CascadeSettings):
        return None
    table, rows = signals.table, len(signals.t)
    each = [(settings.joints[joint.name], f"simulation.joints.{joint.name}") for joint in joints]
    references = {joint.name: settings.joints[joint.name].reference for joint in joints}
    reference = _matrix(table, references, joints, "simulation.joints", POSITIONS)
    extra = []
    for one, where in each:
        column = one.feedforward.get(spec.label) if isinstance(one.feedforward, Mapping) else one.feedforward
        extra.append(np.zeros(rows) if column is None else table.column(column, f"{where}.feedforward"))
    for name, arrays in (("reference", [reference.ravel()]), ("feedforward", extra)):
        size = rows * len(joints) if name == "reference" else rows
        if any(len(array) != size or len(_bad(array)) for array in arrays):
            raise InputError(f"{table.source}: the {name} of the controller is not one valid number per time stamp.")

    def gains(name: str) -> Array:
        values = [(getattr(one, name), f"{where}.{name}") for one, where in each]
        return np.array([np.inf if value is None else table.constant(value, where) for value, where in values])

    names = tuple(joint.name for joint in joints)
    kp, kv, gain, saturation = (gains(name) for name in ("kp", "kv", "gain", "saturation"))
    if not (saturation > 0).all():
        raise ConfigError(f"simulation.joints: saturation is {saturation.min():g}; give a positive number.")
    return CascadePD(names, signals.t, reference, kp, kv, gain, saturation, np.column_stack(extra))


def _transmission(config: Config, joints: Sequence[Joint]) -> Array:
    """Return A (n, n) with motor positions A q; by virtual work the joint torques are A' times the motors'.

    A motor that the configuration does not list turns as its joint. Raises ConfigError where A is singular.
    """
    names = [joint.name for joint in joints]
    gears = np.eye(len(names))
    for motor, row in config.transmission.items():
        gears[names.index(motor)] = [row.get(name, 0.0) for name in names]
    if np.linalg.matrix_rank(gears) < len(names):
        raise ConfigError(
            "transmission: these coefficients are singular, so that joint positions do not follow from the motors'; "
            "each motor needs a coefficient of its own joint."
        )
    return gears


def _used(table: Table, config: Config, joints: Sequence[Joint], *, measured: bool) -> dict[str, Array]:
    """Return the columns that the channels name; InputError where they differ in length."""
    sections = (("position", config.position), *((("torque", config.torque),) if measured else ()))
    used = {} if config.time.column is None else {config.time.column: table.column(config.time.column, "time")}
    for section, channels in sections:
        for joint in joints:
            for name in channels[joint.name].terms:
                used[name] = table.column(name, f"{section}.{joint.name}")
    first, *others = used
    for name in others:
        if len(used[name]) != len(used[first]):
            raise InputError(
                f"{table.source}: columns of different lengths: {first!r} has {len(used[first])} rows, "
                f"{name!r} has {len(used[name])}. Take all columns of a log from one recording."
            )
    return used


def _matrix(
    table: Table,
    channels: Mapping[str, Channel],
    joints: Sequence[Joint],
    section: str,
    units: Mapping[str, str],
) -> Array:
    """Return the channels of all joints in SI, (N, n)."""
    columns = []
    for joint in joints:
        channel, where = channels[joint.name], f"{section}.{joint.name}"
        factor = unit_factor(channel.unit, units[joint.kind], f"{where}.unit")
        with np.errstate(over="ignore", invalid="ignore"):  # the finished log is checked for infinities
            columns.append(factor * _linear(table, channel, where))
    return np.column_stack(columns)


def _linear(table: Table, channel: Channel, where: str) -> Array:
    """Return gain * (sum of columns times coefficients) + offset, in the channel's unit."""
    total = sum(
        (table.constant(gain, where) * table.column(name, where) for name, gain in channel.terms.items()),
        start=np.zeros(1),
    )
    return table.constant(channel.gain, where) * total + table.constant(channel.offset, where)


def _times(table: Table, config: Config, rows: int) -> Array:
    """Return the time stamps in s; InputError where one is missing or does not increase."""
    if config.time.rate is not None:
        return np.arange(rows) / config.time.rate
    name = config.time.column or ""
    column = table.column(name, "time")
    bad = _bad(column)
    if len(bad):
        raise InputError(
            f"{table.source}: column {name!r} has no valid time at {table.place(bad[0])} "
            f"({len(bad)} such rows); delete these rows."
        )
    t = unit_factor(config.time.unit, "time", "time.unit") * column
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        k = back[0]
        what = "repeats" if t[k + 1] == t[k] else f"runs backwards from {t[k]:.9g} s"
        raise InputError(
            f"{table.source}: column {name!r}: the time {t[k + 1]:.9g} s at {table.place(k + 1)} {what} "
            f"({len(back)} such rows); sort the rows by time and keep the first of equal stamps."
        )
    return t


def _bad(values: Array) -> NDArray[np.intp]:
    """Return where values are not finite, or so large that they cannot have been measured."""
    return np.flatnonzero(~(np.abs(values) < _LARGEST))


def _cut(signals: _Signals, window: Interval, joints: Sequence[Joint], name: str) -> Log:
    """Return the log of one window; values outside it need not be finite."""
    start, stop = (-np.inf if window[0] is None else window[0], np.inf if window[1] is None else window[1])
    t, source = signals.t, signals.table.source
    rows = np.flatnonzero((t >= start) & (t <= stop))
    if len(rows) < 2:
        raise InputError(
            f"{source}: the window {interval_words(window)} holds {len(rows)} samples; "
            f"the recording runs from {t[0]:.9g} to {t[-1]:.9g} s."
        )
    for column, values in signals.used.items():
        bad = rows[_bad(values[rows])]
        if len(bad):
            value = values[bad[0]]
            what = "empty or NaN" if np.isnan(value) else f"{value:.3g}"
            raise InputError(
                f"{source}: column {column!r} is {what} at {signals.table.place(bad[0])} "
                f"({len(bad)} such values in all). Mend these samples, or leave them out with a window."
            )
    return Log(t[rows], signals.q[rows], signals.tau[rows], tuple(joint.name for joint in joints), name)


def _pieces(log: Log, gaps: str, source: str) -> tuple[Log, ...]:
    pieces = split_gaps(log) if gaps == "split" else (log,)
    if not pieces:
        raise InputError(f"{source}: the gaps in {log.source!r} leave no piece long enough; widen the window.")
    return pieces


def _checked(log: Log, config: Config, joints: Sequence[Joint], source: str, measured: bool) -> tuple[Finding, ...]:
    """Return the findings on a log; InputError where one of them is an error."""
    findings = check(log, {joint.name: joint.kind for joint in joints}, turning_joints(config), torque=measured)
    require(findings, f"{source} ({log.source})")
    return findings


def turning_joints(config: Config) -> frozenset[str]:
    """Return the joints for which large angles are no sign of degrees declared as radians."""
    return frozenset(name for name, channel in config.position.items() if channel.multi_turn or channel.unit != "rad")


def _overhang(name: str, t: Array, window: Interval) -> Iterator[str]:
    """Say where a window reaches past the recording by more than a sample."""
    step = float(np.median(np.diff(t)))
    start, stop = window
    if (start is not None and start < t[0] - step) or (stop is not None and stop > t[-1] + step):
        yield (
            f"{name}: the window {interval_words(window)} reaches past the recording, "
            f"which runs from {t[0]:.6g} to {t[-1]:.6g} s."
        )


def _left_out(log: Log, pieces: Sequence[Log]) -> Iterator[str]:
    lost = len(log) - sum(map(len, pieces))
    if lost:
        yield f"{log.source}: {lost} samples are left out, in pieces between gaps too short to be smoothed."
