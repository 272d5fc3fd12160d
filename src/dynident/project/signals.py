"""The declared channels of a table in SI units: times, positions and torques."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.files.tables import DataTable
from dynident.models import Joint
from dynident.models.simulation import PD, PID, CascadePD, DifferencingLoop, Function, HasTimes
from dynident.motion.log import Controller
from dynident.project.drive_settings import CascadeSettings, FunctionSettings, LoopJoint, LoopSettings, PIDSettings
from dynident.project.fields import POSITIONS, TORQUES, VELOCITIES, Angle, Channel, unit_factor
from dynident.project.settings import Config, LogSpec
from dynident.runtime import ConfigError, InputError, count
from dynident.runtime.arrays import Array

MIN_STEP_SHARE = 1e-4  # share of the usual step
_EPISODE_COLUMN = re.compile(r"(episode|run|set|split|trial|traj|trajectory)([ _.]?(index|idx|id|number|no))?")
_MAX_VALUE = 1e100  # a larger value is damaged, and its square may overflow
_MAX_DISORDER = 12  # usual steps by which rows that were exchanged run backwards
_COUNTER_BITS = (16, 32)
SETTINGS_PATH = "simulation.joints"


@dataclass(frozen=True, eq=False)
class RecordedSignals:
    """All rows of a recording: t (N) s, q and tau (N, n) in SI, and the columns they come from."""

    table: DataTable
    columns: Mapping[str, Array]
    t: Array
    q: Array
    tau: Array
    measured: bool


def column_names(config: Config, spec: LogSpec) -> set[str]:
    """Return the columns that a configuration reads of a recording; also scalars, where gains name them."""
    channels: list[Channel] = [*config.position.values(), *config.torque.values()]
    names = {config.time.column} if config.time.column else set()
    if isinstance(config.simulation, LoopSettings):
        for loop in config.simulation.joints.values():
            rate = getattr(loop, "velocity_reference", None)
            channels += [loop.reference, *([] if rate is None else [rate])]
            names.add(loop.column(spec.label) or "")
    return names.union(*(channel.terms for channel in channels))


def has_torques(table: DataTable, config: Config, joints: Sequence[Joint]) -> bool:
    """Whether the table has any column of a torque."""
    available_names = {*table.columns, *table.constants, *table.faults}
    channels = [config.torque[joint.name] for joint in joints if joint.name in config.torque]
    return any(name in available_names for channel in channels for name in channel.terms)


def signals(table: DataTable, config: Config, joints: Sequence[Joint], *, measured: bool) -> RecordedSignals:
    """Return the channels of the joints; torques are zero where they are not ``measured``.

    Incomplete rows at both ends (with ``gaps: split`` all), duplicate rows and, with ``close_stamps: drop``, rows right
    after the previous one are dropped, with a note of the table. Raises ConfigError where the transmission is singular,
    InputError where a column is missing or a time is wrong.
    """
    # incomplete and repeated rows go first, since they would count as close ones
    table = _drop_unusable_rows(table, _used_columns(table, config, joints, measured=measured), config)
    table = _drop_close_rows(table, config)
    used = _used_columns(table, config, joints, measured=measured)
    rows = len(next(iter(used.values())))
    q, tau = joint_values(table, config, joints, measured=measured)
    return RecordedSignals(
        table=table, columns=used, t=_time_stamps(table, config, rows), q=q, tau=tau, measured=measured
    )


def joint_values(
    table: DataTable, config: Config, joints: Sequence[Joint], *, measured: bool = True
) -> tuple[Array, Array]:
    """Return positions and torques (N, n) of the joints, in SI; raises as ``signals``."""
    q: Array = channel_values(table, config.position, joints, "position", POSITIONS)
    tau = channel_values(table, config.torque, joints, "torque", TORQUES) if measured else np.zeros(q.shape)
    if config.transmission:
        # motor positions are A q; by virtual work, tau = A' tau_motor
        gears = _transmission(config, joints)
        with np.errstate(over="ignore", invalid="ignore"):
            q, tau = np.asarray(np.linalg.solve(gears, q.T).T, dtype=float), tau @ gears
    return q + np.array([config.zero.get(joint.name, 0.0) for joint in joints]), tau


def _transmission(config: Config, joints: Sequence[Joint]) -> Array:
    """Return A (n, n) with motor positions A q; by virtual work the joint torques are A' times those of the motors.

    A motor that the configuration does not list has the position of its joint. Raises ConfigError for a singular A.
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


def _used_columns(table: DataTable, config: Config, joints: Sequence[Joint], *, measured: bool) -> dict[str, Array]:
    """Return the columns that the channels name; InputError where they differ in length."""
    sections = (("position", config.position), *((("torque", config.torque),) if measured else ()))
    columns = {} if config.time.column is None else {config.time.column: table.column(config.time.column, "time")}
    for section, channels in sections:
        for joint in joints:
            for name in channels[joint.name].terms:
                columns[name] = table.column(name, f"{section}.{joint.name}")
    first_name, *other_names = columns
    for name in other_names:
        if len(columns[name]) != len(columns[first_name]):
            raise InputError(
                f"{table.source}: columns of different lengths: {first_name!r} has {len(columns[first_name])} rows, "
                f"{name!r} has {len(columns[name])}. Take all columns of a log from one recording."
            )
    return columns


def _drop_unusable_rows(table: DataTable, used_columns: Mapping[str, Array], config: Config) -> DataTable:
    """Drop incomplete rows at the start and the end, where gaps may be split all of them, and rows written twice."""
    columns, stamped = list(used_columns.values()), config.time.column is not None
    keep = ~np.logical_or.reduce([np.isnan(column) for column in columns])
    if not keep.any():
        if all(np.isfinite(column).any() for column in columns):
            raise InputError(
                f"{table.source}: no row has values in all columns that are used: positions and torques have stamps of "
                "their own. Interpolate the torques at the stamps of the positions, in one row for each."
            )
        return table
    place = "" if stamped and config.gaps == "split" else " at the ends"
    if place:
        complete_rows = np.flatnonzero(keep)
        keep[complete_rows[0] : complete_rows[-1] + 1] = True
    if not keep.all():
        rows = count(int((~keep).sum()), "row")
        table = table.select_rows(keep, f"{rows}{place} left out, where columns are empty or NaN.")
        columns = [column[keep] for column in columns]
    # a row repeats the previous one only where all of its columns do
    is_new = np.zeros(len(columns[0]), dtype=bool)
    is_new[0] = True
    for column in columns:
        is_new[1:] |= column[1:] != column[:-1]
        if is_new.all():
            break
    if is_new.all() or not stamped:  # without stamps, equal rows are a joint at rest
        return table
    return table.select_rows(
        is_new, f"{count(int((~is_new).sum()), 'row')} left out as equal to the previous one, including its time."
    )


def _drop_close_rows(table: DataTable, config: Config) -> DataTable:
    """Drop rows whose stamp nearly is the previous one, or InputError, as ``close_stamps`` says.

    Whatever lies between two such rows is noise: their difference quotient is no velocity.
    """
    name, policy = config.time.column, config.close_stamps
    if name is None or policy == "keep":
        return table
    t = table.column(name, "time")
    with np.errstate(over="ignore", invalid="ignore"):  # bad stamps are refused later
        steps = np.diff(t)
    # the median of the positive steps is robust against repeated stamps
    usual_step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    is_candidate = steps >= 0 if policy == "drop" else steps > 0  # equal stamps are refused with the others
    close = np.flatnonzero(is_candidate & (steps < MIN_STEP_SHARE * usual_step))
    if not len(close):
        return table
    fault = f"{count(len(close), 'row')} less than {MIN_STEP_SHARE:g} of the usual step after the previous one"
    if policy == "drop":
        keep = np.ones(len(t), dtype=bool)
        keep[close + 1] = False
        return table.select_rows(keep, f"{fault}, the first at {table.place(close[0] + 1)}: left out.")
    factor = unit_factor(config.time.unit, "time", "time.unit")
    raise InputError(
        f"{table.source}: column {name!r}: the time at {table.place(close[0] + 1)} is {factor * steps[close[0]]:.3g} s "
        f"after the previous one, where {factor * usual_step:.3g} s is usual ({fault}); `close_stamps: drop` leaves "
        "such rows out, `close_stamps: keep` fits them."
    )


def channel_values(
    table: DataTable,
    channels: Mapping[str, Channel],
    joints: Sequence[Joint],
    section: str,
    units: Mapping[str, str],
) -> Array:
    """Return the channels of the joints in SI, (N, n); ``units`` are the dimensions by the kinds of joints."""
    columns = []
    for joint in joints:
        channel, where = channels[joint.name], f"{section}.{joint.name}"
        factor = unit_factor(channel.unit, units[joint.kind], f"{where}.unit")
        with np.errstate(over="ignore", invalid="ignore"):  # the finished log is checked for infinities
            columns.append(factor * _linear_combination(table, channel, where))
    return np.column_stack(columns)


def _linear_combination(table: DataTable, channel: Channel, where: str) -> Array:
    """Return gain * (sum of columns times coefficients) + offset, in the channel's unit."""
    wraps = channel.wraps if isinstance(channel, Angle) else None
    # columns are unwrapped before they are summed: a sum would jump by other amounts
    total = np.zeros(1)
    for name, gain in channel.terms.items():
        total = total + table.constant(gain, where) * unwrap(table.column(name, where), wraps)
    return table.constant(channel.gain, where) * total + table.constant(channel.offset, where)


def unwrap(values: Array, wraps: float | None) -> Array:
    """Return values (N) that wrap around with the period ``wraps`` as continuous ones: no step exceeds half of it."""
    if wraps is None:
        return values
    # a damaged value would shift all that follow by turns
    is_valid, continuous = np.abs(values) < _MAX_VALUE, values.copy()
    continuous[is_valid] = np.unwrap(values[is_valid], period=wraps)
    return continuous


def _time_stamps(table: DataTable, config: Config, rows: int) -> Array:
    """Return the time stamps in s; InputError where one is missing or does not increase."""
    if config.time.rate is not None:
        return np.arange(rows) / config.time.rate
    name = config.time.column or ""
    column = table.column(name, "time")
    check_times(table, name, column)
    factor = unit_factor(config.time.unit, "time", "time.unit")
    if (unit := table.units.get(name)) is not None and factor != unit_factor(unit, "time", "time.unit"):
        raise ConfigError(
            f"time.unit: {config.time.unit!r}, but column {name!r} of {table.source} holds dates, times or durations, "
            f"which are read in {unit}; write `unit: {unit}`."
        )
    t = factor * column
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        k = back[0]
        fault = "repeats" if t[k + 1] == t[k] else f"runs backwards from {t[k]:.15g} s"
        raise InputError(
            f"{table.source}: column {name!r}: the time {t[k + 1]:.15g} s at {table.place(k + 1)} {fault} "
            f"({count(len(back), 'such row')}); {_episode_hint(table)}{order_hint(column)}."
        )
    return t


def order_hint(column: Array) -> str:
    """Return what to do where stamps (N), as they are in the file, run backwards.

    By a few steps rows were exchanged, by 2^16 or 2^32 a counter starts anew, by others the clock was set.
    """
    steps = np.diff(column)
    usual, back = float(np.median(np.abs(steps))), -float(steps.min())
    for bits in _COUNTER_BITS:
        if column.max() < 2**bits and abs(back + usual - 2**bits) <= _MAX_DISORDER * usual:
            return f"the counter of {bits} bits starts anew: add 2^{bits} to the rows from there on, or give the `rate`"
    if back <= _MAX_DISORDER * usual:
        return "sort the rows, and keep the first of equal stamps (`close_stamps: drop`); if rounded, give the `rate`"
    return "the clock was set back there, or another recording begins: write the rows before and after to two logs"


def _episode_hint(table: DataTable) -> str:
    """Return what to do where a column says that a file holds several recordings."""
    names = (*table.columns, *table.unread, *table.faults)
    name = next((name for name in names if _EPISODE_COLUMN.fullmatch(name.lower().rpartition(".")[2])), None)
    if name is None:
        return ""
    return f"does the file hold several recordings, by {name!r}? Then write each to a file of its own; else "


def check_times(table: DataTable, name: str, t: Array) -> None:
    """Raise InputError where a row of the column has no valid time."""
    bad = bad_values(t)
    if len(bad):
        raise InputError(
            f"{table.source}: column {name!r} has no valid time at {table.place(bad[0])} "
            f"({count(len(bad), 'such row')}); delete these rows."
        )


def bad_values(values: Array) -> NDArray[np.intp]:
    """Return where values are not finite, or implausibly large."""
    return np.flatnonzero(~(np.abs(values) < _MAX_VALUE))


def controller(signals: RecordedSignals, settings: object, spec: LogSpec, joints: Sequence[Joint]) -> Controller | None:
    """Return the controller of a recording, None where the configuration has none.

    Raises InputError where a reference or a gain is missing, ConfigError for gains with which a joint does not follow.
    """
    if not isinstance(settings, LoopSettings):
        return None
    driver = _logged_controller(signals, settings, spec, joints)
    # a controller may work at a lower rate than that of the recording
    try:
        driver = driver if settings.period is None else driver.every(settings.period)
    except InputError as error:
        raise ConfigError(f"simulation.period: {signals.table.source}: {error}") from error
    # its velocity may be a difference of positions over several of its steps
    return driver if settings.velocity_steps == 1 else DifferencingLoop(driver, settings.velocity_steps)


def _logged_controller(
    signals: RecordedSignals, settings: LoopSettings, spec: LogSpec, joints: Sequence[Joint]
) -> HasTimes:
    """Return the controller, with its references as they were logged."""
    reader = _DriveReader(signals, [settings.joints[joint.name] for joint in joints], joints)
    common_fields: dict[str, Any] = {"joints": tuple(joint.name for joint in joints), "t": signals.t}
    common_fields |= {"reference": reader.signal("reference", POSITIONS), "feedforward": reader.feedforward(spec)}
    common_fields |= {name: reader.gains(name) for name in ("gain", "saturation")}
    # without a saturation the limit is infinite; anything else must be positive
    if not (common_fields["saturation"] > 0).all():
        k = int(np.argmin(common_fields["saturation"] > 0))
        value = common_fields["saturation"][k]
        raise ConfigError(
            f"{SETTINGS_PATH}.{joints[k].name}.saturation: saturation is {value:g}; give a positive number."
        )
    if isinstance(settings, FunctionSettings):
        return Function(law=settings.law, **common_fields)
    if isinstance(settings, CascadeSettings):
        kp, kv = reader.gains("kp"), reader.gains("kv")
        # without stiffness in position a simulation would drift away from the reference
        reader.check_stiffness(kp * kv)
        return CascadePD(kp=kp, kv=kv, **common_fields)
    kp, ki = reader.gains("kp"), reader.gains("ki") if isinstance(settings, PIDSettings) else None
    reader.check_stiffness(kp if ki is None else np.hypot(kp, ki))
    kd, velocity = reader.gains("kd"), reader.signal("velocity_reference", VELOCITIES)
    pd = PD(kp=kp, kd=kd, velocity_reference=velocity, **common_fields)
    return pd if ki is None else PID(pd, ki)


class _DriveReader:
    """Reads the signals and gains of the joints' drives, as the settings name them, from a recording."""

    def __init__(self, signals: RecordedSignals, drives: Sequence[LoopJoint], joints: Sequence[Joint]) -> None:
        self.table, self.rows = signals.table, len(signals.t)
        self.drives = list(zip(drives, joints, strict=True))

    def signal(self, name: str, units: Mapping[str, str]) -> Array | None:
        """Return a channel of the drives (N, n), zero at joints without one; None where no joint has one."""
        columns = []
        for drive, joint in self.drives:
            columns.append(np.zeros(self.rows))
            if (channel := getattr(drive, name, None)) is not None:
                columns[-1] = channel_values(self.table, {joint.name: channel}, [joint], SETTINGS_PATH, units)[:, 0]
                _require_valid(self.table, name.replace("_", " "), columns[-1], self.rows)
        return np.column_stack(columns) if any(getattr(drive, name, None) for drive, _ in self.drives) else None

    def feedforward(self, spec: LogSpec) -> Array:
        """Return the feedforward of the drives (N, n) in a recording, zero where there is none."""
        columns = []
        for drive, joint in self.drives:
            column = drive.column(spec.label)
            where = f"{SETTINGS_PATH}.{joint.name}.feedforward"
            columns.append(np.zeros(self.rows) if column is None else self.table.column(column, where))
            _require_valid(self.table, "feedforward", columns[-1], self.rows)
        return np.column_stack(columns)

    def gains(self, name: str) -> Array:
        """Return a number of each drive (n), infinite where it is not given."""
        values = [(getattr(drive, name), f"{SETTINGS_PATH}.{joint.name}.{name}") for drive, joint in self.drives]
        return np.array([np.inf if value is None else self.table.constant(value, where) for value, where in values])

    def check_stiffness(self, stiffness: Array) -> None:
        """Raise ConfigError for a joint whose position does not matter to its controller."""
        for (_, joint), value in zip(self.drives, stiffness, strict=True):
            if not value:
                raise ConfigError(
                    f"{SETTINGS_PATH}.{joint.name}: with these gains, of which one is 0, the joint does not follow its "
                    "reference; give its gains, or simulate from the torque (`kind: measured_torque`)."
                )


def _require_valid(table: DataTable, name: str, values: Array, size: int) -> None:
    if len(values) != size or len(bad_values(values)):
        raise InputError(f"{table.source}: the {name} of the controller is not one valid number per time stamp.")
