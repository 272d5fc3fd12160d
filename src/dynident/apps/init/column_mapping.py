"""Proposal of a configuration from the names and values of columns, each with its reason or a question."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dynident.apps.init.match import (
    Match,
    MovableJoint,
    best_pair,
    complete_rows,
    headerless_families,
    is_of_motors,
    match_length,
    turn_size,
)
from dynident.apps.init.servo_draft import command_columns
from dynident.apps.init.shape_match import match_by_shape, match_torque_by_shape, sampling_step
from dynident.apps.init.stamps import TimeColumn, even_time, finite_values, has_gaps, time_column
from dynident.files.tables import DataTable
from dynident.identification import held_joints
from dynident.project.columns import ColumnFamily, families, read_name, stated_unit
from dynident.project.fields import POSITIONS, TORQUES, UNITS, unit_factor, unit_size
from dynident.project.signals import unwrap
from dynident.runtime.arrays import Array

_LOCK_DECIMALS = 6  # digits of locked positions
_MAX_LOCKED_MOTION = 1e-3  # rad or m: a locked joint that moves more raises a question
FULL_TURN = 360.0  # degrees: what starts anew after it is in these
_LIMIT_SLACK = 1.05  # on limits of position
_MAX_LIMIT_RATIO, _MIN_EFFORT_RATIO = 1.5, 0.02  # times the effort limit: torques beyond are hardly joint torques


@dataclass(frozen=True)
class ChannelProposal:
    """A proposed channel of a joint: its column (None: not found), its unit, and the questions to confirm.

    ``gain`` says what the gain means where the column is not a torque yet; ``factor`` is an estimate of it, where the
    logs show it. ``wraps`` is the turn after which a position starts anew, in the unit of the column.
    """

    column: str | None
    unit: str
    questions: tuple[str, ...] = ()
    gain: str = ""
    factor: float | None = None
    wraps: float | None = None

    @property
    def question(self) -> str:
        """All questions in one text."""
        return "; ".join(self.questions)

    @property
    def needs_gain(self) -> bool:
        """Whether a gain is to be filled in."""
        return bool(self.gain) and self.factor is None


@dataclass(frozen=True)
class ColumnMapping:
    """Channels by joint, in the order of the robot file, and the joints to lock with their positions.

    ``still_joints`` are the locked joints that are recorded with position and torque but do not move. ``reasons``
    say how the columns of "position" and "torque" were matched. ``unused`` are columns of the same length without
    a use, and ``unknown_joints`` those of them that are positions of joints that the robot does not have.
    ``gaps`` says whether the stamps have any, or rows are empty. ``command`` has the commanded positions where there is
    no torque. ``gravity`` (m/s^2) is that of a base that is mounted otherwise than the robot file has it, else None.
    """

    time: TimeColumn
    position: Mapping[str, ChannelProposal]
    torque: Mapping[str, ChannelProposal]
    lock: Mapping[str, tuple[float, str]]
    reasons: Mapping[str, str]
    unused: tuple[str, ...]
    unknown_joints: tuple[str, ...]
    gaps: bool
    still_joints: tuple[str, ...] = ()
    command: Mapping[str, ChannelProposal] = field(default_factory=dict)
    gravity: tuple[float, float, float] | None = None


def widths(tables: Mapping[str, DataTable]) -> dict[str, int]:
    """Return the widths of the text files of a recording that hold one number per line and several per time stamp.

    The shortest column has one number per stamp; the others must hold a multiple.
    """
    lengths = {key: len(next(iter(table.columns.values()))) for key, table in tables.items() if len(table.columns) == 1}
    shortest = min(lengths.values(), default=0)
    return {key: n // shortest for key, n in lengths.items() if n > shortest and n % shortest == 0}


def map_columns(
    table: DataTable,
    joints: Sequence[MovableJoint],
    ros: bool = False,
    other_tables: Sequence[DataTable] = (),
    lockable: bool = True,
) -> ColumnMapping:
    """Propose the channels of a recording for the joints of a robot.

    With ``ros``, the units are those of JointState. Joints that move neither here nor in ``other_tables`` are
    locked if the model is ``lockable`` and some joint moves. Missing columns raise no error: what is not found is
    None, and what is uncertain has a question.
    """
    usable = [joint for joint in joints if not joint.follows]
    # names first; values only where the names say nothing or match no position and torque
    named_families = families(table.columns, [joint.name for joint in joints])
    column_families = named_families or headerless_families(table, len(usable))
    position, torque = best_pair(table, column_families, usable)
    nameless = all(name.isdecimal() for name in table.columns) or position is torque is None
    # values are compared only here, as this is slower and less certain than names
    if nameless:
        shape_matches = match_by_shape(table, usable)
        position, torque = shape_matches if all(shape_matches) else (position or shape_matches[0], torque)
    elif position and torque is None:
        torque = match_torque_by_shape(table, usable, position)
    table = complete_rows(table, (position, torque))
    # those with position and torque, or with what there is of both
    recorded = [set(match.columns) for match in (position, torque) if match and match.columns]
    names = set.intersection(*recorded) if recorded else {joint.name for joint in usable}
    # joints that never move are locked, unless this would leave none to identify
    signals = _position_channels(table, usable, position, ros)
    matched_joints = [joint for joint in usable if joint.name in names]
    still = _still_joints([table, *other_tables], matched_joints, signals) if lockable else ()
    names = names.difference(still) or names
    identified_joints = [joint for joint in usable if joint.name in names]
    rows = match_length(table, position or torque)
    time = time_column(table, column_families, rows, ros, nameless=nameless)
    time = even_time(table, time, position.columns.values()) if position else time
    if time.column is None and not time.step > 0 and position:
        time = replace(time, step=sampling_step(table, position))
    commands = command_columns(table, usable, position) if torque is None else {}
    torques = _torque_channels(table, identified_joints, torque, ros)
    channels = [*signals.values(), *torques.values()]
    used_columns = {time.column, *commands.values(), *(channel.column for channel in channels)}
    unused = tuple(name for name, column in table.columns.items() if name not in used_columns and len(column) == rows)
    locked = _lock_positions(table, joints, names, signals)
    positions = (
        (joint.name, signals.get(joint.name, _missing_channel(joint, POSITIONS))) for joint in identified_joints
    )
    return ColumnMapping(
        time=time,
        position=dict(positions),
        torque=torques,
        lock={name: (q, "" if name in still else why) for name, (q, why) in locked.items()},
        reasons={
            section: match.reason + _unit_reason(match.family, by_joint, ros)
            for section, match, by_joint in (("position", position, signals), ("torque", torque, torques))
            if match
        },
        unused=unused,
        unknown_joints=_unknown_joint_columns(unused, position, joints),
        gaps=has_gaps(table, time),
        still_joints=tuple(name for name in still if name not in names),
        command={name: replace(signals[name], column=column) for name, column in commands.items() if name in names},
    )


def _still_joints(
    tables: Sequence[DataTable], joints: Iterable[MovableJoint], recorded: Mapping[str, ChannelProposal]
) -> tuple[str, ...]:
    """Return the joints whose position does not change over all recordings, or is held by their controllers."""
    joints = list(joints)
    # the range over all recordings together: a joint may stand at another position in each of them
    reach = np.array([_motion_range(tables, joint, recorded.get(joint.name)) for joint in joints])
    is_recorded = np.isfinite(reach)
    is_held = is_recorded & held_joints(np.where(is_recorded, reach, 0.0), [joint.kind for joint in joints])
    return tuple(
        joint.name for joint, is_still in zip(joints, is_held | (reach <= _MAX_LOCKED_MOTION), strict=True) if is_still
    )


def _motion_range(tables: Sequence[DataTable], joint: MovableJoint, signal: ChannelProposal | None) -> float:
    """Return the range of a joint over all recordings, in rad or m; infinite where it is not known."""
    if signal is None or signal.column is None:
        return math.inf
    recordings = [finite_values(table.columns[signal.column]) for table in tables if signal.column in table.columns]
    ends = [end for q in recordings if len(q) for end in (q.min(), q.max())]
    return unit_factor(signal.unit, POSITIONS[joint.kind], "") * float(np.ptp(ends)) if ends else math.inf


def _unknown_joint_columns(
    unused: Iterable[str], position: Match | None, joints: Sequence[MovableJoint]
) -> tuple[str, ...]:
    """Return the position columns that name no joint, where the other positions are matched by name."""
    if position is None or not all(isinstance(key, str) for key in position.family.columns):
        return ()
    parsed = [read_name(column, [joint.name for joint in joints]) for column in unused]
    like = ("position", None, position.family.rank)
    return tuple(name.column for name in parsed if (name.role, name.joint, name.rank) == like)


def _position_channels(
    table: DataTable, joints: Sequence[MovableJoint], match: Match | None, ros: bool
) -> dict[str, ChannelProposal]:
    """Return the position channels of the matched joints; those of revolute joints may look like degrees."""
    if match is None:
        return {}
    joints = [joint for joint in joints if joint.name in match.columns]
    values = {joint.name: finite_values(table.columns[match.columns[joint.name]]) for joint in joints}
    units = match.family.units
    # unwrap before the units are judged: a wrapped angle hides the range that tells rad from degrees
    turns = {joint.name: turn_size(values[joint.name], units.get(match.columns[joint.name], "")) for joint in joints
             if joint.kind == "revolute"}  # fmt: skip
    if len({units.get(match.columns[name]) for name in turns}) == 1:  # what starts anew tells of those that do not
        turns = dict.fromkeys(turns, next(filter(None, turns.values()), None))
    values = {name: unwrap(q, turns.get(name)) for name, q in values.items()}
    in_degrees = {match.columns[name]: "deg" for name, turn in turns.items() if turn == FULL_TURN}
    match = replace(match, family=replace(match.family, units={**in_degrees, **units}))
    revolute = [(joint, values[joint.name]) for joint in joints if joint.kind == "revolute"]
    degrees = "" if ros else _degrees_question(revolute)
    return {
        joint.name: replace(_position_channel(joint, values[joint.name], match, degrees), wraps=turns.get(joint.name))
        for joint in joints
    }


def _degrees_question(revolute: Sequence[tuple[MovableJoint, Array]]) -> str:
    """Ask whether positions are in degrees, if they are within reach of the joints in degrees but not in rad."""
    # a question is asked only where degrees explain what rad do not; a smaller range is that of another zero
    span = max((float(np.ptp(q)) for _, q in revolute if len(q)), default=0.0)
    in_rad, in_deg = (
        all(_is_within_reach(joint, q, factor) for joint, q in revolute) for factor in (1.0, math.pi / 180)
    )
    if in_rad or not in_deg or span <= 2 * math.pi:
        return ""
    return f"a range of {span:.3g} is too much for rad: is it in degrees, or before the gear (see `transmission`)?"


def _position_channel(joint: MovableJoint, q: Array, match: Match, degrees: str) -> ChannelProposal:
    """Return the position channel of a joint.

    ``degrees`` is the question to ask where the positions of revolute joints look like degrees, else empty.
    """
    column, dimension = match.columns[joint.name], POSITIONS[joint.kind]
    unit, doubt = match.family.units.get(column, ""), ""
    if size := unit_size(unit, dimension):
        if _is_motor_side(joint, size * q):
            doubt = "it moves further than the joint can: is it of the motor side of the gear (see `transmission`)?"
    elif degrees and joint.kind == "revolute":
        unit, doubt = "deg", degrees
    else:
        unit, doubt = _si_unit(joint, POSITIONS), _unit_question(joint, q)
        if stated := stated_unit(column, [joint.name]):
            doubt = (
                f"its name says {stated!r}, which is not read as a unit of position: then `gain`, or another `unit`?"
            )
        if joint.kind == "prismatic" and doubt and len(q) and _is_within_reach(joint, q, UNITS[dimension]["mm"]):
            unit = "mm"  # as the question supposes
    return ChannelProposal(column, unit, _nonempty(match.question, doubt))


def _nonempty(*texts: str) -> tuple[str, ...]:
    """Return the texts that are not empty."""
    return tuple(filter(None, texts))


def _is_within_reach(joint: MovableJoint, q: Array, factor: float) -> bool:
    """Return whether positions times ``factor``, in rad or m, are within what the joint can reach."""
    if not len(q):
        return True
    low, high = factor * float(q.min()), factor * float(q.max())
    lower, upper = joint.limits.lower, joint.limits.upper
    if lower is not None and upper is not None and lower < upper:
        # some slack, as measured positions may pass a limit by their noise or by play
        slack = (_LIMIT_SLACK - 1) * (upper - lower)
        return lower - slack <= low and high <= upper + slack
    return high - low <= (2 * math.pi if joint.kind == "revolute" else 10.0)


def _is_motor_side(joint: MovableJoint, q: Array) -> bool:
    """Return whether positions in rad or m span far more than the limits of the joint, as those of motors do."""
    lower, upper = joint.limits.lower, joint.limits.upper
    if lower is None or upper is None or not len(q):
        return False
    return 0 < _MAX_LIMIT_RATIO * (upper - lower) < float(np.ptp(q))


def _unit_question(joint: MovableJoint, q: Array) -> str:
    """Return the question about a position in rad or m whose unit is not in its name."""
    if not len(q):
        return "the column is empty"
    span, low, high = float(np.ptp(q)), f"{q.min():.3g}", f"{q.max():.3g}"
    slides = joint.kind == "prismatic"
    if _is_within_reach(joint, q, 1.0):
        return "" if slides or span > 0.02 or span == 0 else f"the joint moves by only {span:.2g}: is it in rad?"
    if slides:
        return f"{low} to {high} is more than the joint can move in m: is it in mm, or of a motor (then `gain`)?"
    # a joint without limits may turn several times: ask before it is called degrees
    if joint.limits.lower is None:
        return (
            f"the range {span:.3g} exceeds 2 pi: does it turn that far (then `multi_turn: true`), or is it in degrees?"
        )
    return f"{low} to {high} exceeds the range of the joint in rad: degrees, encoder counts, another zero, or a motor?"


def _missing_channel(joint: MovableJoint, dimensions: Mapping[str, str]) -> ChannelProposal:
    return ChannelProposal(None, _si_unit(joint, dimensions))


def _si_unit(joint: MovableJoint, dimensions: Mapping[str, str]) -> str:
    return next(unit for unit, factor in UNITS[dimensions[joint.kind]].items() if factor == 1)


def _torque_channels(
    table: DataTable, joints: Sequence[MovableJoint], match: Match | None, ros: bool
) -> dict[str, ChannelProposal]:
    if match is None:
        return {joint.name: _missing_channel(joint, TORQUES) for joint in joints}
    if match.family.role == "current":
        return {joint.name: _current_channel(joint, match) for joint in joints}
    columns = {joint.name: finite_values(table.columns[match.columns[joint.name]]) for joint in joints}
    peaks = {name: float(np.abs(column).max(initial=0.0)) for name, column in columns.items()}
    # relative to the limits, as the sizes of joints differ by decades
    ratios = [peaks[joint.name] / joint.limits.effort for joint in joints if joint.limits.effort]
    largest_ratio = max(ratios, default=None)
    return {joint.name: _torque_channel(joint, match, peaks[joint.name], largest_ratio, ros) for joint in joints}


def _current_channel(joint: MovableJoint, match: Match) -> ChannelProposal:
    """Return the torque channel of a joint from its motor current, with the meaning of its gain."""
    column, unit = match.columns[joint.name], _si_unit(joint, TORQUES)
    current_unit = match.family.units.get(column, "A or mA")
    of_current = f"torque constant times gear ratio, {unit} per {current_unit}"
    gain = f"{unit} at the joint per '%'" if current_unit == "%" else of_current
    return ChannelProposal(column, unit, _nonempty(match.question), gain)


def _torque_channel(
    joint: MovableJoint, match: Match, peak: float, largest_ratio: float | None, ros: bool
) -> ChannelProposal:
    """Return the torque channel of a joint.

    ``largest_ratio`` is the largest peak of all joints, relative to the effort limit of the robot file.
    """
    column, limit = match.columns[joint.name], joint.limits.effort
    unit, doubt = match.family.units.get(column, ""), ""
    if unit_size(unit, TORQUES[joint.kind]):
        doubt = "its name is that of a motor: is it before the gear? Then `gain`." if is_of_motors(match) else ""
        return ChannelProposal(column, unit, _nonempty(match.question, doubt))
    unit = _si_unit(joint, TORQUES)
    if stated := stated_unit(column, [joint.name]):
        return ChannelProposal(column, unit, _nonempty(match.question), f"{unit} at the joint per {stated!r}")
    # a torque beyond its limit is likely in other units; a small one only if that holds for all joints
    if limit and peak / limit > _MAX_LIMIT_RATIO:
        doubt = (
            f"the peak {peak:.3g} exceeds the limit {limit:.3g} {unit} of the "
            "robot file: is it a current in mA, or another unit?"
        )
    elif largest_ratio is not None and largest_ratio < _MIN_EFFORT_RATIO:
        doubt = (
            f"the peak {peak:.2g} is small against the limit of the robot file: is it the motor's, "
            "before the gear, or a current? Then `gain`."
        )
    elif largest_ratio is None and not ros:
        doubt = f"neither the names nor the robot file tell the unit: {unit}?"
    return ChannelProposal(column, unit, _nonempty(match.question, doubt))


def _unit_reason(family: ColumnFamily, channels: Mapping[str, ChannelProposal], ros: bool) -> str:
    if any(channel.gain for channel in channels.values()):
        return ""
    if family.units:
        return "; the unit is in their names"
    if ros:
        return "; the unit is that of ROS" + (", but some drivers send currents" if family.role == "torque" else "")
    return "; the unit is judged by the values and the limits in the robot file"


def _lock_positions(
    table: DataTable, joints: Sequence[MovableJoint], identified: set[str], recorded: Mapping[str, ChannelProposal]
) -> dict[str, tuple[float, str]]:
    """Return the positions, in rad or m, of the joints that are not identified, and questions about them.

    A joint that follows a locked one needs no value.
    """
    lock: dict[str, tuple[float, str]] = {}
    for joint in joints:
        if joint.name in identified or (joint.follows and joint.follows not in identified):
            continue
        signal, unit = recorded.get(joint.name), _si_unit(joint, POSITIONS)
        if joint.follows:
            lock[joint.name] = 0.0, f"it follows {joint.follows!r}, which moves: a model cannot have both"
        elif signal is not None and signal.column is not None:
            q = finite_values(table.columns[signal.column]) * unit_factor(signal.unit, POSITIONS[joint.kind], "")
            span = float(np.ptp(q)) if len(q) else 0.0
            moves = f"it moves by {span:.2g} {unit} in the log" if span > _MAX_LOCKED_MOTION else ""
            lock[joint.name] = (round(float(np.median(q)), _LOCK_DECIMALS) + 0.0 if len(q) else 0.0), moves
        else:
            lock[joint.name] = joint.limits.nearest_to_zero, f"it is not in the log: where does it stand ({unit})?"
    return lock
