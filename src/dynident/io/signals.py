"""The declared channels of a table in SI units: times, positions and torques."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError
from dynident.io.channels import POSITIONS, TORQUES, Angle, Channel
from dynident.io.fields import unit_factor
from dynident.io.settings import Config, LogSpec
from dynident.io.simulation_settings import LoopSettings, PDJoint
from dynident.io.tables import DataTable
from dynident.models import Joint

__all__ = [
    "RecordedSignals",
    "bad_values",
    "channel_values",
    "column_names",
    "has_torques",
    "joint_values",
    "signals",
    "unwrapped",
]

Array = NDArray[np.float64]

CLOSE = 1e-4  # share of the usual step
_EPISODES = ("episode", "episode_index", "episode_id")
_LARGEST = 1e100  # a larger value is damaged, and its square may overflow


@dataclass(frozen=True, eq=False)
class RecordedSignals:
    """All rows of a recording: t (N) s, q and tau (N, n) in SI, and the columns they come from."""

    table: DataTable
    used: Mapping[str, Array]
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
            rate = loop.velocity_reference if isinstance(loop, PDJoint) else None
            channels += [loop.reference, *([] if rate is None else [rate])]
            names.add(loop.column(spec.label) or "")
    return names.union(*(channel.terms for channel in channels))


def has_torques(table: DataTable, config: Config, joints: Sequence[Joint]) -> bool:
    """Whether the table has any column of a torque."""
    known = {*table.columns, *table.constants, *table.faults}
    return any(name in known for joint in joints for name in config.torque[joint.name].terms)


def signals(table: DataTable, config: Config, joints: Sequence[Joint], *, measured: bool) -> RecordedSignals:
    """Return the channels of the joints; torques are zero where they are not ``measured``.

    Incomplete rows at both ends, duplicate rows and, with ``close_stamps: drop``, rows right after the previous one are
    dropped, with a note of the table. Raises ConfigError where the transmission is singular, InputError where a column
    is missing or a time is wrong.
    """
    table = _tidy(table, _used(table, config, joints, measured=measured), config.time.column is not None)
    table = _spaced(table, config)
    used = _used(table, config, joints, measured=measured)
    rows = len(next(iter(used.values())))
    q, tau = joint_values(table, config, joints, measured=measured)
    return RecordedSignals(table=table, used=used, t=_times(table, config, rows), q=q, tau=tau, measured=measured)


def joint_values(
    table: DataTable, config: Config, joints: Sequence[Joint], *, measured: bool = True
) -> tuple[Array, Array]:
    """Return positions and torques (N, n) of the joints, in SI; raises as ``signals``."""
    q: Array = channel_values(table, config.position, joints, "position", POSITIONS)
    tau = channel_values(table, config.torque, joints, "torque", TORQUES) if measured else np.zeros(q.shape)
    if config.transmission:
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


def _used(table: DataTable, config: Config, joints: Sequence[Joint], *, measured: bool) -> dict[str, Array]:
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


def _tidy(table: DataTable, used: Mapping[str, Array], stamped: bool) -> DataTable:
    """Drop incomplete rows at the start and the end, and rows written twice."""
    columns = list(used.values())
    whole = np.flatnonzero(~np.logical_or.reduce([np.isnan(one) for one in columns]))
    if not len(whole):
        return table
    first, last, rows = int(whole[0]), int(whole[-1]), len(columns[0])
    if last - first + 1 < rows:
        inside = np.zeros(rows, dtype=bool)
        inside[first : last + 1] = True
        lost = rows - inside.sum()
        table = table.kept(inside, f"{lost} rows at the ends, where columns are empty or NaN, are left out.")
        columns = [one[inside] for one in columns]
    new = np.zeros(len(columns[0]), dtype=bool)
    new[0] = True
    for one in columns:
        new[1:] |= one[1:] != one[:-1]
        if new.all():
            break
    if new.all() or not stamped:  # without stamps, equal rows are a joint at rest
        return table
    return table.kept(new, f"{(~new).sum()} rows that repeat the previous one, including its time, are left out.")


def _spaced(table: DataTable, config: Config) -> DataTable:
    """Drop rows whose stamp nearly is the previous one, or InputError, as ``close_stamps`` says.

    Whatever lies between two such rows is noise: their difference quotient is no velocity.
    """
    name, wanted = config.time.column, config.close_stamps
    if name is None or wanted == "keep":
        return table
    t = table.column(name, "time")
    with np.errstate(over="ignore", invalid="ignore"):  # bad stamps are refused later
        steps = np.diff(t)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    same = steps >= 0 if wanted == "drop" else steps > 0  # equal stamps are refused with the others
    close = np.flatnonzero(same & (steps < CLOSE * usual))
    if not len(close):
        return table
    what = f"{len(close)} rows follow the previous one by less than {CLOSE:g} of the usual step"
    if wanted == "drop":
        keep = np.ones(len(t), dtype=bool)
        keep[close + 1] = False
        return table.kept(keep, f"{what}, the first at {table.place(close[0] + 1)}; they are left out.")
    factor = unit_factor(config.time.unit, "time", "time.unit")
    raise InputError(
        f"{table.source}: column {name!r}: the time at {table.place(close[0] + 1)} is {factor * steps[close[0]]:.3g} s "
        f"after the previous one, where {factor * usual:.3g} s is usual ({what}); `close_stamps: drop` leaves such "
        "rows out, `close_stamps: keep` fits them."
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
            columns.append(factor * _linear(table, channel, where))
    return np.column_stack(columns)


def _linear(table: DataTable, channel: Channel, where: str) -> Array:
    """Return gain * (sum of columns times coefficients) + offset, in the channel's unit."""
    wraps = channel.wraps if isinstance(channel, Angle) else None
    total = np.zeros(1)
    for name, gain in channel.terms.items():
        total = total + table.constant(gain, where) * unwrapped(table.column(name, where), wraps)
    return table.constant(channel.gain, where) * total + table.constant(channel.offset, where)


def unwrapped(values: Array, wraps: float | None) -> Array:
    """Return values (N) that start anew at ``wraps`` as they go on: no step is larger than half of it."""
    if wraps is None:
        return values
    known, found = np.abs(values) < _LARGEST, values.copy()
    found[known] = np.unwrap(values[known], period=wraps)
    return found


def _times(table: DataTable, config: Config, rows: int) -> Array:
    """Return the time stamps in s; InputError where one is missing or does not increase."""
    if config.time.rate is not None:
        return np.arange(rows) / config.time.rate
    name = config.time.column or ""
    column = table.column(name, "time")
    bad = bad_values(column)
    if len(bad):
        raise InputError(
            f"{table.source}: column {name!r} has no valid time at {table.place(bad[0])} "
            f"({len(bad)} such rows); delete these rows."
        )
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
        what = "repeats" if t[k + 1] == t[k] else f"runs backwards from {t[k]:.15g} s"
        raise InputError(
            f"{table.source}: column {name!r}: the time {t[k + 1]:.15g} s at {table.place(k + 1)} {what} "
            f"({len(back)} such rows); {_episodes(table)}sort the rows by time and keep the first of equal stamps "
            "(`close_stamps: drop`)."
        )
    return t


def _episodes(table: DataTable) -> str:
    """Return what to do where a column says that a file holds several recordings."""
    known = (*table.columns, *table.unread)
    name = next((name for name in known if name.lower().rpartition(".")[2] in _EPISODES), None)
    if name is None:
        return ""
    return f"does the file hold several recordings, by {name!r}? Then write each to a file of its own; else "


def bad_values(values: Array) -> NDArray[np.intp]:
    """Return where values are not finite, or implausibly large."""
    return np.flatnonzero(~(np.abs(values) < _LARGEST))
