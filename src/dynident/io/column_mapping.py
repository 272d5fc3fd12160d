"""Proposes a configuration from the names and values of columns: each with its reason, or a question where unsure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from dynident.identification import hardly_moving
from dynident.io.channels import POSITIONS, TORQUES
from dynident.io.columns import ColumnFamily, families, read_name
from dynident.io.fields import UNITS
from dynident.io.match import JointFacts, Match, best_pair, finite, headerless, rows_of, turn
from dynident.io.shape_match import match_by_shape
from dynident.io.signals import unwrapped
from dynident.io.tables import DataTable
from dynident.io.time_column import TimeColumn, has_gaps, time_column

__all__ = ["ColumnMapping", "Signal", "map_columns", "widths"]

Array = NDArray[np.float64]

_DECIMALS = 6  # digits of locked positions
_STILL = 1e-3  # rad or m: a locked joint that moves more raises a question
_SLACK = 1.05  # on limits of position
_OVER, _UNDER = 1.5, 0.02  # times the effort limit: torques beyond are hardly joint torques


@dataclass(frozen=True)
class Signal:
    """A channel of a joint: its column (None: not found), its unit, and a question to confirm.

    ``gain`` says what the gain is, where the column is no torque yet; ``factor`` is an estimate of it and its standard
    error, where the motion shows it. ``wraps`` is the turn after which a position starts anew, in the column's unit.
    """

    column: str | None
    unit: str
    question: str = ""
    gain: str = ""
    factor: tuple[float, float] | None = None
    wraps: float | None = None


@dataclass(frozen=True)
class ColumnMapping:
    """Channels by joint, in the order of the robot file; the joints to lock, and at which position.

    ``still`` are those of them that are recorded with position and torque but do not move.
    ``reasons`` say how the columns of "position" and "torque" were matched; ``left`` are unused columns of the same
    length, ``strangers`` those of them that are positions of joints that the robot does not have; ``gaps``: whether the
    stamps have any.
    """

    time: TimeColumn
    position: Mapping[str, Signal]
    torque: Mapping[str, Signal]
    lock: Mapping[str, tuple[float, str]]
    reasons: Mapping[str, str]
    left: tuple[str, ...]
    strangers: tuple[str, ...]
    gaps: bool
    still: tuple[str, ...] = ()


def widths(tables: Mapping[str, DataTable]) -> dict[str, int]:
    """Return the widths of the text files of a recording that hold one number per line and several per time stamp.

    The shortest column has one number per stamp; the others must hold a multiple.
    """
    lengths = {key: len(next(iter(one.columns.values()))) for key, one in tables.items() if len(one.columns) == 1}
    shortest = min(lengths.values(), default=0)
    return {key: n // shortest for key, n in lengths.items() if n > shortest and n % shortest == 0}


def map_columns(
    table: DataTable,
    joints: Sequence[JointFacts],
    ros: bool = False,
    others: Sequence[DataTable] = (),
    lockable: bool = True,
) -> ColumnMapping:
    """Propose the channels of a recording for the joints of a robot; ``ros``: the units are those of JointState.

    Joints that move neither in it nor in the ``others`` are locked, where the model is ``lockable`` and some joint
    moves.
    Raises nothing where a column is missing: what is not found is None, what is uncertain has a question.
    """
    usable = [joint for joint in joints if not joint.follows]
    found = families(table.columns, [joint.name for joint in joints]) or headerless(table, len(usable))
    position, torque = best_pair(table, found, usable)
    nameless = all(name.isdecimal() for name in table.columns) or position is torque is None
    if nameless:
        shaped = match_by_shape(table, usable)
        position, torque = shaped if all(shaped) else (position or shaped[0], torque)
    names = _shared(position, torque, usable)
    signals = _positions(table, usable, position, ros)
    still = _still([table, *others], [joint for joint in usable if joint.name in names], signals) if lockable else ()
    names = names.difference(still) or names
    used = [joint for joint in usable if joint.name in names]
    rows = rows_of(table, position or torque)
    time = time_column(table, found, rows, ros, nameless=nameless)
    matches = {key: match for key, match in (("position", position), ("torque", torque)) if match}
    left = _left(table, rows, time, matches.values())
    locked = _lock(table, joints, names, signals)
    return ColumnMapping(
        time=time,
        position=_complete(signals, used),
        torque=_torques(table, used, torque, ros),
        lock={name: (q, "" if name in still else why) for name, (q, why) in locked.items()},
        reasons={key: match.reason + _unit_reason(match.family, ros) for key, match in matches.items()},
        left=left,
        strangers=_strangers(left, position, joints),
        gaps=has_gaps(table, time),
        still=tuple(name for name in still if name not in names),
    )


def _still(
    tables: Sequence[DataTable], joints: Iterable[JointFacts], recorded: Mapping[str, Signal]
) -> tuple[str, ...]:
    """Return the joints with a position that is the same in all recordings, or where their controllers hold them."""
    joints = list(joints)
    reach = np.array([_range(tables, joint, recorded.get(joint.name)) for joint in joints])
    known = np.isfinite(reach)
    held = known & hardly_moving(np.where(known, reach, 0.0), [joint.kind for joint in joints])
    return tuple(joint.name for joint, one in zip(joints, held | (reach <= _STILL), strict=True) if one)


def _range(tables: Sequence[DataTable], joint: JointFacts, signal: Signal | None) -> float:
    """Return how far a joint moves in all recordings together, in rad or m; infinite where that is not known."""
    if signal is None or signal.column is None:
        return math.inf
    known = [finite(table.columns[signal.column]) for table in tables if signal.column in table.columns]
    ends = [end for q in known if len(q) for end in (q.min(), q.max())]
    return UNITS[POSITIONS[joint.kind]][signal.unit] * float(np.ptp(ends)) if ends else math.inf


def _complete(signals: Mapping[str, Signal], joints: Iterable[JointFacts]) -> dict[str, Signal]:
    """Return the positions of all joints, in their order, those without a column too."""
    return {joint.name: signals.get(joint.name, _unknown(joint, POSITIONS)) for joint in joints}


def _left(table: DataTable, rows: int, time: TimeColumn, matches: Iterable[Match]) -> tuple[str, ...]:
    """Return the columns of that length that are neither the time nor matched."""
    taken = {time.column, *chain.from_iterable(match.columns.values() for match in matches)}
    return tuple(name for name, column in table.columns.items() if name not in taken and len(column) == rows)


def _strangers(left: Iterable[str], position: Match | None, joints: Sequence[JointFacts]) -> tuple[str, ...]:
    """Return the positions that name no joint, where the other positions are matched by names."""
    if position is None or not all(isinstance(key, str) for key in position.family.columns):
        return ()
    read = (read_name(column, [joint.name for joint in joints]) for column in left)
    return tuple(
        one.column for one in read if one.role == "position" and one.joint is None and one.rank == position.family.rank
    )


def _shared(one: Match | None, other: Match | None, joints: Sequence[JointFacts]) -> set[str]:
    """Return the joints to identify: those with position and torque, or with what was found of the two."""
    matched = [set(match.columns) for match in (one, other) if match and match.columns]
    return set.intersection(*matched) if matched else {joint.name for joint in joints}


def _positions(table: DataTable, joints: Sequence[JointFacts], match: Match | None, ros: bool) -> dict[str, Signal]:
    """Return the positions of the joints that are matched; those of turning joints may look like degrees."""
    if match is None:
        return {}
    joints = [joint for joint in joints if joint.name in match.columns]
    values = {joint.name: finite(table.columns[match.columns[joint.name]]) for joint in joints}
    units = match.family.units
    turns = {joint.name: turn(values[joint.name], units.get(match.columns[joint.name], "")) for joint in joints
             if joint.kind == "revolute"}  # fmt: skip
    values = {name: unwrapped(q, turns.get(name)) for name, q in values.items()}
    degrees = "" if ros else _degrees([(joint, values[joint.name]) for joint in joints if joint.kind == "revolute"])
    return {
        joint.name: replace(_position(joint, values[joint.name], match, degrees), wraps=turns.get(joint.name))
        for joint in joints
    }


def _degrees(turning: Sequence[tuple[JointFacts, Array]]) -> str:
    """Return the question whether positions are in degrees, where they fit the joints so, and not in rad."""
    in_rad, in_deg = (all(_fits(joint, q, factor) for joint, q in turning) for factor in (1.0, math.pi / 180))
    if in_rad or not in_deg:
        return ""
    span = max((float(np.ptp(q)) for _, q in turning if len(q)), default=0.0)
    return f"a range of {span:.3g} is too much for rad: is it in degrees, or before the gear (see `transmission`)?"


def _position(joint: JointFacts, q: Array, match: Match, degrees: str) -> Signal:
    """Return the position of a joint; ``degrees`` is the question where turning joints look like that, else empty."""
    column, known = match.columns[joint.name], UNITS[POSITIONS[joint.kind]]
    unit, doubt = match.family.units.get(column, ""), ""
    if unit in known:
        if _geared(joint, known[unit] * q):
            doubt = "it moves further than the joint can: is it of the motor side of the gear (see `transmission`)?"
    elif degrees and joint.kind == "revolute":
        unit, doubt = "deg", degrees
    else:
        unit, doubt = _si(joint, POSITIONS), _doubt(joint, q)
    return Signal(column, unit, _asked(match.question, doubt))


def _asked(*questions: str) -> str:
    """Join the questions that are not empty."""
    return "; ".join(filter(None, questions))


def _fits(joint: JointFacts, q: Array, factor: float) -> bool:
    """Whether positions times ``factor``, in rad or m, are within what the joint can reach."""
    if not len(q):
        return True
    low, high = factor * float(q.min()), factor * float(q.max())
    lower, upper = joint.limits.lower, joint.limits.upper
    if lower is not None and upper is not None and lower < upper:
        slack = (_SLACK - 1) * (upper - lower)
        return lower - slack <= low and high <= upper + slack
    return high - low <= (2 * math.pi if joint.kind == "revolute" else 10.0)


def _geared(joint: JointFacts, q: Array) -> bool:
    """Whether positions in rad or m span far more than the joint's limits, as those of motors do."""
    lower, upper = joint.limits.lower, joint.limits.upper
    return len(q) > 0 and lower is not None and upper is not None and 0 < _OVER * (upper - lower) < float(np.ptp(q))


def _doubt(joint: JointFacts, q: Array) -> str:
    """Return the question about a position in rad or m whose unit is not in its name."""
    if not len(q):
        return "the column is empty"
    span, low, high = float(np.ptp(q)), f"{q.min():.3g}", f"{q.max():.3g}"
    if joint.kind == "prismatic":
        return "" if _fits(joint, q, 1.0) else f"{low} to {high} is more than the joint can move in m: is it in mm?"
    if _fits(joint, q, 1.0):
        return "" if span > 0.02 or span == 0 else f"the joint moves by only {span:.2g}: is it in rad?"
    if joint.limits.lower is None and span > 2 * math.pi:
        return (
            f"the range {span:.3g} exceeds 2 pi: does it turn that far (then `multi_turn: true`), or is it in degrees?"
        )
    return f"{low} to {high} exceeds the range of the joint in rad: degrees, encoder counts, another zero, or a motor?"


def _unknown(joint: JointFacts, dimensions: Mapping[str, str]) -> Signal:
    """Return a channel without a column, in SI."""
    return Signal(None, _si(joint, dimensions))


def _si(joint: JointFacts, dimensions: Mapping[str, str]) -> str:
    return next(unit for unit, factor in UNITS[dimensions[joint.kind]].items() if factor == 1)


def _torques(table: DataTable, joints: Sequence[JointFacts], match: Match | None, ros: bool) -> dict[str, Signal]:
    if match is None:
        return {joint.name: _unknown(joint, TORQUES) for joint in joints}
    if match.family.role == "current":
        return {joint.name: _current(joint, match) for joint in joints}
    columns = {joint.name: finite(table.columns[match.columns[joint.name]]) for joint in joints}
    peaks = {name: float(np.abs(column).max(initial=0.0)) for name, column in columns.items()}
    ratios = [peaks[joint.name] / joint.limits.effort for joint in joints if joint.limits.effort]
    most = max(ratios, default=None)
    return {joint.name: _torque(joint, match, peaks[joint.name], most, ros) for joint in joints}


def _current(joint: JointFacts, match: Match) -> Signal:
    """Return the torque channel of a joint from its motor current, with the meaning of its gain."""
    column, unit = match.columns[joint.name], _si(joint, TORQUES)
    per = match.family.units.get(column, "A or mA")
    return Signal(column, unit, match.question, f"torque constant times gear ratio, {unit} per {per}")


def _torque(joint: JointFacts, match: Match, peak: float, most: float | None, ros: bool) -> Signal:
    """Return the torque of a joint; ``most`` is the largest peak of all joints by the limit of the robot file."""
    column, limit = match.columns[joint.name], joint.limits.effort
    unit, doubt = match.family.units.get(column, ""), ""
    if unit in UNITS[TORQUES[joint.kind]]:
        return Signal(column, unit, match.question)
    unit = _si(joint, TORQUES)
    if limit and peak / limit > _OVER:
        doubt = (
            f"the peak {peak:.3g} exceeds the limit {limit:.3g} {unit} of the "
            "robot file: is it a current in mA, or another unit?"
        )
    elif most is not None and most < _UNDER:
        doubt = (
            f"the peak {peak:.2g} is small against the limit of the robot file: is it the motor's, "
            "before the gear, or a current? Then `gain`."
        )
    elif most is None and not ros:
        doubt = f"neither the names nor the robot file tell the unit: {unit}?"
    return Signal(column, unit, _asked(match.question, doubt))


def _unit_reason(family: ColumnFamily, ros: bool) -> str:
    if family.role == "current":
        return ""
    if family.units:
        return "; the unit is in their names"
    if ros:
        return "; the unit is that of ROS" + (", but some drivers send currents" if family.role == "torque" else "")
    return "; the unit is judged by the values and the limits in the robot file"


def _lock(
    table: DataTable, joints: Sequence[JointFacts], used: set[str], recorded: Mapping[str, Signal]
) -> dict[str, tuple[float, str]]:
    """Return the positions, in rad or m, of the joints that are not identified, and questions about them.

    A joint that follows a fixed one needs no value.
    """
    lock: dict[str, tuple[float, str]] = {}
    for joint in joints:
        if joint.name in used or (joint.follows and joint.follows not in used):
            continue
        signal = recorded.get(joint.name)
        if joint.follows:
            lock[joint.name] = 0.0, f"it follows {joint.follows!r}, which moves: a model cannot have both"
        elif signal is not None and signal.column is not None:
            lock[joint.name] = _rest(joint, finite(table.columns[signal.column]), signal.unit)
        else:
            lock[joint.name] = _unrecorded(joint)
    return lock


def _rest(joint: JointFacts, column: Array, unit: str) -> tuple[float, str]:
    """Return the position of a recorded joint, and a question where it moves."""
    q = column * UNITS[POSITIONS[joint.kind]][unit]
    if not len(q):
        return 0.0, ""
    moves = f"it moves by {np.ptp(q):.2g} {_si(joint, POSITIONS)} in the log" if np.ptp(q) > _STILL else ""
    return round(float(np.median(q)), _DECIMALS) + 0.0, moves


def _unrecorded(joint: JointFacts) -> tuple[float, str]:
    """Return the position nearest to zero within the limits of a joint, and the question where it stands."""
    low = -math.inf if joint.limits.lower is None else joint.limits.lower
    high = math.inf if joint.limits.upper is None else joint.limits.upper
    return min(max(0.0, low), high), f"it is not in the log: where does it stand ({_si(joint, POSITIONS)})?"
