"""Matching of the columns of a recording to the joints of a robot: by name, by number, or by order."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from dynident.apps.init.stamps import finite_values, is_increasing
from dynident.files.tables import DataTable
from dynident.files.xml_text import SUFFIXES
from dynident.models.rigid_bodies import read_robot_file
from dynident.models.robot_files import JointCoupling, RobotFile, RobotJointLimits
from dynident.project.columns import COMMANDED, ColumnFamily, ColumnName, read_name, tokens
from dynident.project.config import load_model, robot_text
from dynident.project.fields import unit_size
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array

# turns: the step of an angle that starts anew, and the range of its values
_MIN_JUMP_TURNS, _MIN_SPAN_TURNS = 0.9, 0.97
_MOTOR_WORDS = {"motor", "motors", "rotor", "drive"}
_MAX_STILL_SHARE = 0.1  # of the range of every motor that moves: a motor with less is none of the joints


@dataclass(frozen=True)
class MovableJoint:
    """A joint of the robot file that may move; ``follows`` names the joint that it is coupled to."""

    name: str
    kind: str
    limits: RobotJointLimits = field(default_factory=RobotJointLimits)
    follows: str = ""

    def can_move(self, span: float, *, degrees: bool = False) -> bool:
        """Return whether its limits let it move by a span in rad or m, or in ``degrees`` or mm."""
        lower, upper = self.limits.lower, self.limits.upper
        reach = upper - lower if lower is not None and upper is not None and lower < upper else 4 * math.pi
        unit = 1.0 if not degrees else 180 / math.pi if self.kind == "revolute" else 1000.0
        return span <= 1.1 * reach * unit


@dataclass(frozen=True)
class Match:
    """Columns of a family by joint, how they were matched, and a question to confirm the match."""

    family: ColumnFamily
    columns: Mapping[str, str]
    reason: str
    question: str = ""


def headerless_families(table: DataTable, count: int) -> list[ColumnFamily]:
    """Return families for columns 0, 1, ...: time first, then positions, perhaps velocities, and torques."""
    names = list(table.columns)
    if not names or not all(name.isdecimal() for name in names):
        return []
    clocks = [name for name in names if is_increasing(table.columns[name])]  # of several, their values tell
    time_family = [ColumnFamily("time", 0, {None: names[0]})] if clocks == names[:1] else []
    remaining = names[len(time_family) :]
    # either positions and torques, or velocities in between
    if len(remaining) not in (2 * count, 3 * count):
        return time_family
    parts = {"position": remaining[:count], "torque": remaining[-count:]}
    return [*time_family, *(ColumnFamily(role, 0, dict(enumerate(part))) for role, part in parts.items())]


def best_pair(
    table: DataTable, column_families: Iterable[ColumnFamily], joints: Sequence[MovableJoint]
) -> tuple[Match | None, Match | None]:
    """Return the columns of positions and of torques.

    Of the pairs of equal length, prefer those for the most joints, and measured, unfiltered columns. Commanded
    quantities are never used, currents only where there are no torques.
    """
    joints_by_number, column_families = _stated_joints(table, joints), list(column_families)
    of_positions = (family for family in column_families if family.role == "position")
    moving = (_moving_numbers(table, family, len(joints)) for family in of_positions)
    candidates = [*moving, *map(_numbers, column_families)]
    numbers = next((keys for keys in candidates if len(keys) == len(joints)), [])
    family_matches = (
        match_family(family, joints, joints_by_number, numbers) for family in column_families if family.rank > COMMANDED
    )
    matches = [match for match in family_matches if match.columns]
    turning = {joint.name for joint in joints if joint.kind == "revolute"}
    positions = [match for match in matches if match.family.role == "position" and not _has_length(match, turning)]
    # counts of an encoder are far beyond the joints
    positions = [
        match for match in positions if match.family.units or _can_be_angles(table, match, joints)
    ] or positions
    torques = [match for match in matches if match.family.role in ("torque", "current")]
    # all pairs of one length are compared, each also without its partner: positions alone beat a wrong pair
    pairs = (
        pair
        for pair in product([*positions, None], [*torques, None])
        if len({match_length(table, match) for match in pair if match}) == 1
    )
    position, torque = max(pairs, key=_pair_merit, default=(None, None))
    return _ask_about_rivals(table, position, positions), _ask_about_rivals(table, torque, torques)


def _can_be_angles(table: DataTable, match: Match, joints: Sequence[MovableJoint]) -> bool:
    """Return whether the columns span no more than the joints can move, in rad and m, or in degrees and mm."""
    columns = {name: finite_values(table.columns[column]) for name, column in match.columns.items()}
    spans = [(joint, np.ptp(columns[joint.name])) for joint in joints if len(columns.get(joint.name, ()))]
    return any(all(joint.can_move(span, degrees=degrees) for joint, span in spans) for degrees in (False, True))


def _has_length(match: Match, joints: Collection[str]) -> bool:
    """Return whether the column of one of the joints has a unit of length."""
    units = match.family.units
    return any(unit_size(units.get(column, ""), "length") for joint, column in match.columns.items() if joint in joints)


def is_of_motors(match: Match) -> bool:
    """Return whether the columns are named as those of motors, which differ from those of joints by a gear."""
    return not _MOTOR_WORDS.isdisjoint(tokens(next(iter(match.columns.values()))))


def _pair_merit(pair: tuple[Match | None, Match | None]) -> tuple[float, ...]:
    """Return the sort key of a pair of positions and torques, the most important criterion first."""
    matches = [match for match in pair if match]
    common = set.intersection(*(set(match.columns) for match in matches))
    return (
        len(matches) if common else 0,
        len(common),
        sum(match.family.rank for match in matches),
        any(match.family.role == "torque" for match in matches),
        -sum(is_of_motors(match) for match in matches),
        sum(bool(match.family.units) for match in matches),  # degrees rather than counts
        -sum(bool(match.question) for match in matches),
        pair[0] is not None,
    )


def _ask_about_rivals(table: DataTable, match: Match | None, candidates: Iterable[Match]) -> Match | None:
    """Return the match with a question where other columns have equivalent names for as many joints."""
    if match is None:
        return None

    def key(candidate: Match) -> tuple[Any, ...]:
        family, columns = candidate.family, candidate.columns
        length, of_motors = match_length(table, candidate), is_of_motors(candidate)
        return family.role, family.rank, of_motors, bool(family.units), set(columns), length

    # rivals are equal in all that the choice was made by, so that the order of the file decided
    others = (candidate for candidate in candidates if candidate is not match and key(candidate) == key(match))
    rivals = " or ".join(repr(next(iter(candidate.columns.values()))) for candidate in others)
    rival_question = f"why not {rivals}, whose name has the same meaning?" if rivals else ""
    return replace(match, question="; ".join(filter(None, (match.question, rival_question))))


def _stated_joints(table: DataTable, joints: Sequence[MovableJoint]) -> dict[int, str]:
    """Return the joints that text columns name in all rows, by the number in the names of these columns."""
    names = {joint.name for joint in joints}
    joint_columns = {column: joint for column, joint in table.texts.items() if joint in names}
    stated = {
        int(words[-1]): joint for column, joint in joint_columns.items() if (words := tokens(column))[-1].isdecimal()
    }
    return stated if len(set(stated.values())) == len(joint_columns) else {}


def _numbers(family: ColumnFamily) -> list[int]:
    """Return the numbers of a family's columns, in order."""
    return sorted(key for key in family.columns if isinstance(key, int))


def _moving_numbers(table: DataTable, family: ColumnFamily, count: int) -> list[int]:
    """Return ``count`` successive numbers of columns that move, none where any other column does, too."""
    columns = {k: finite_values(table.columns[family.columns[k]]) for k in _numbers(family)}
    spans = {k: float(np.ptp(column)) if len(column) else 0.0 for k, column in columns.items()}
    ranked = sorted(spans, key=lambda k: -spans[k])
    moving, still = sorted(ranked[:count]), ranked[count:]
    is_apart = bool(still) and spans[still[0]] < _MAX_STILL_SHARE * min(spans[k] for k in moving)
    return moving if is_apart and moving[-1] - moving[0] < count else []


def match_family(
    family: ColumnFamily,
    joints: Sequence[MovableJoint],
    stated: Mapping[int, str] | None = None,
    numbers: Sequence[int] = (),
) -> Match:
    """Match the columns of a family to joints.

    Columns are matched by name, by the numbers that the file has ``stated`` of joints, by the number in the joint
    names, else by order: that of the ``numbers`` that belong to all joints, where they are among them or have these.
    """
    if any(isinstance(key, str) for key in family.columns):
        columns = {joint.name: family.columns[joint.name] for joint in joints if joint.name in family.columns}
        return Match(family, columns, "the columns have the names of the joints")
    if None in family.columns or len(family.columns) == len(joints) == 1:
        columns = {joint.name: next(iter(family.columns.values())) for joint in joints} if len(joints) == 1 else {}
        return Match(family, columns, "there is one joint")
    if stated and set(stated) <= set(_numbers(family)):
        return Match(family, {joint: family.columns[k] for k, joint in stated.items()}, "the file names the joints")
    return _match_by_number(family, {key: family.columns[key] for key in _numbers(family)}, joints, numbers)


def _match_by_number(
    family: ColumnFamily, numbered: Mapping[int, str], joints: Sequence[MovableJoint], all_numbers: Sequence[int]
) -> Match:
    """Match numbered columns to the joints whose names have these numbers, else to as many joints in order."""
    chains = _numbered_chains(joints)
    for chain in chains:
        # the numbers of the columns must be exactly those of a chain of joints, else only their order is used
        if sorted(chain) == list(numbered):
            by_number = {chain[k]: column for k, column in numbered.items()}
            return Match(family, by_number, "matched by the number in the joints' names")
    # columns of some joints only, or of more motors, have the numbers of those of all joints
    is_part = set(numbered) <= set(all_numbers) or set(all_numbers) <= set(numbered)
    numbers = all_numbers if all_numbers and is_part else list(numbered)
    order = next((list(chain.values()) for chain in chains if len(chain) == len(numbers)), None)
    joint_of = dict(zip(numbers, order or [joint.name for joint in joints], strict=False))
    matched = {joint_of[k]: column for k, column in numbered.items() if k in joint_of}
    names = list(matched)
    order_question = "is this order right?"
    if len(matched) < len(numbered):
        order_question = f"are {', '.join(str(k) for k in numbered if k in joint_of)} theirs, in this order?"
    question = (
        f"the columns are numbered {min(numbered)} to {max(numbered)} and the joints are called {names[0]} to "
        f"{names[-1]}: {order_question}"
    )
    return Match(family, matched, "matched by order", question)


def _numbered_chains(joints: Iterable[MovableJoint]) -> list[dict[int, str]]:
    """Return the joints whose names differ only in their last number, by that number; the longest chain first."""
    chains: dict[tuple[str, ...], dict[int, str]] = {}
    for joint in joints:
        words = tokens(joint.name)
        at = max((k for k, word in enumerate(words) if word.isdecimal()), default=None)
        if at is not None:
            chains.setdefault((*words[:at], "", *words[at + 1 :]), {}).setdefault(int(words[at]), joint.name)
    return sorted(({k: chain[k] for k in sorted(chain)} for chain in chains.values()), key=len, reverse=True)


def match_length(table: DataTable, match: Match | None) -> int:
    """Return the length of the matched columns; without a match that of the first column, or 0."""
    columns = list(match.columns.values()) if match else list(table.columns)
    return len(table.columns[columns[0]]) if columns else 0


def columns_beside(
    table: DataTable, joints: Sequence[MovableJoint], position: Match | None, accepts: Callable[[ColumnName], bool]
) -> list[dict[str, str]]:
    """Return the groups of columns by joint that ``accepts`` takes and that are named or numbered as the positions."""
    if position is None:
        return []
    names = [joint.name for joint in joints]
    parsed_positions = {joint: read_name(column, names) for joint, column in position.columns.items()}
    joint_of = {name.joint or name.number: joint for joint, name in parsed_positions.items()}
    groups: dict[tuple[str, ...], dict[str, str]] = {}
    rows = match_length(table, position)
    for name in (read_name(column, names) for column in table.columns):
        values, joint = table.columns[name.column], joint_of.get(name.joint or name.number)
        if joint and len(values) == rows and np.isfinite(values).any() and accepts(name):
            groups.setdefault(name.family, {}).setdefault(joint, name.column)
    return [group for group in groups.values() if group.keys() == position.columns.keys()]


def turn_size(q: Array, unit: str) -> float | None:
    """Return the turn after which an angle starts anew, in its unit; None where it does not.

    Without a unit, the angle may be in rad or degrees.
    """
    # an angle without a unit may wrap at 2 pi or at 360
    sizes = [2 * math.pi / size] if (size := unit_size(unit, "angle")) else [2 * math.pi, 360.0]
    steps, span = np.abs(np.diff(q)), float(np.ptp(q)) if len(q) else 0.0
    for size in sizes:
        # wraps are jumps of nearly a turn within a span of one turn, with small steps in between
        jumps, is_turn = steps > _MIN_JUMP_TURNS * size, _MIN_SPAN_TURNS * size < span < size * (1 + 1e-6)
        if jumps.any() and is_turn and steps[~jumps].max(initial=0.0) < 0.25 * size:
            return round(size, 12)
    return None


def complete_rows(table: DataTable, matches: Iterable[Match | None]) -> DataTable:
    """Return the table without the rows where matched columns are empty, as those of other topics, if any is left."""
    columns = [table.columns[name] for match in matches if match for name in match.columns.values()]
    if len({len(column) for column in columns}) != 1:
        return table
    keep = np.asarray(~np.isnan(columns).any(axis=0))
    return table if keep.all() or not keep.any() else table.select_rows(keep, "")


def read_joints(robot: str) -> list[MovableJoint]:
    """Return the single-coordinate joints of a robot file in its order, or those of a model of a configuration.

    Raises ModelError where it cannot be read, or has no such joint.
    """
    path = Path(robot)
    if path.suffix.lower() not in SUFFIXES:
        return [MovableJoint(joint.name, joint.kind) for joint in load_model(robot).joints]
    file = read_robot_file(robot_text(path), path.name)
    bound = _coupled_joints(file)
    joints = [
        MovableJoint(joint.name, joint.kind, joint.limits, bound.get(joint.name, ""))
        for joint in file.joints
        if joint.kind != "fixed" and not joint.follows  # a mimic joint moves, or stands, with its master
    ]
    if all(joint.follows for joint in joints):
        raise ModelError(f"{robot}: has no revolute or prismatic joint, so there is nothing to identify.")
    return joints


def _coupled_joints(file: RobotFile) -> dict[str, str]:
    """Return the joint that each coupled joint follows, by name."""
    bound: dict[str, str] = {}
    for constraint in file.constraints:
        if isinstance(constraint, JointCoupling):
            for name in constraint.joints:
                bound.setdefault(name, next((joint for joint in constraint.joints if joint != name), name))
    return bound
