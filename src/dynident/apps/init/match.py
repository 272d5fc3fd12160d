"""Matching of the columns of a recording to the joints of a robot: by name, by number, or by order."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from dynident.files.tables import DataTable
from dynident.files.xml_text import SUFFIXES
from dynident.models.rigid_bodies import read_robot_file
from dynident.models.robot_files import JointCoupling, RobotFile, RobotJointLimits
from dynident.project.columns import ColumnFamily, tokens
from dynident.project.config import load_model, robot_text
from dynident.project.fields import UNITS, unit_factor, unit_size
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array

_MAX_VALUE = 1e100
# turns: the step of an angle that starts anew, and the range of its values
_MIN_JUMP_TURNS, _MIN_SPAN_TURNS = 0.9, 0.97

_MIN_STEP, _MAX_STEP = 5e-5, 0.3  # s: sampling steps that are taken for granted
# samples, and deviation of the steps, of a column that is a clock without being called so
_MIN_CLOCK_SAMPLES, _MAX_STEP_DEVIATION = 30, 0.1
_LONG_FORMAT_QUESTION = (
    "most rows have the time of the row before: is there a better column? If each row is of another joint, write one "
    "row for each time instead, with a column for each joint and quantity"
)
_GAP_RATIO = 12  # times the median step, as in the reading of logs


@dataclass(frozen=True)
class MovableJoint:
    """A joint of the robot file that may move; ``follows`` names the joint that it is coupled to."""

    name: str
    kind: str
    limits: RobotJointLimits = field(default_factory=RobotJointLimits)
    follows: str = ""


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
    numbers = next((keys for family in column_families if len(keys := _numbers(family)) == len(joints)), [])
    family_matches = (
        match_family(family, joints, joints_by_number, numbers) for family in column_families if family.rank > -2
    )
    matches = [match for match in family_matches if match.columns]
    turning = {joint.name for joint in joints if joint.kind == "revolute"}
    positions = [match for match in matches if match.family.role == "position" and not _has_length(match, turning)]
    torques = [match for match in matches if match.family.role in ("torque", "current")]
    # all pairs of one length are compared, each also without its partner: positions alone beat a wrong pair
    pairs = (
        pair
        for pair in product([*positions, None], [*torques, None])
        if len({match_length(table, match) for match in pair if match}) == 1
    )
    position, torque = max(pairs, key=_pair_merit, default=(None, None))
    return _ask_about_rivals(table, position, positions), _ask_about_rivals(table, torque, torques)


def _has_length(match: Match, joints: Collection[str]) -> bool:
    """Return whether the column of one of the joints has a unit of length."""
    units = match.family.units
    return any(unit_size(units.get(column, ""), "length") for joint, column in match.columns.items() if joint in joints)


def _pair_merit(pair: tuple[Match | None, Match | None]) -> tuple[float, ...]:
    """Return the sort key of a pair of positions and torques, the most important criterion first."""
    matches = [match for match in pair if match]
    common = set.intersection(*(set(match.columns) for match in matches))
    return (
        len(matches) if common else 0,
        len(common),
        sum(match.family.rank for match in matches),
        any(match.family.role == "torque" for match in matches),
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
        return family.role, family.rank, bool(family.units), set(columns), match_length(table, candidate)

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


def match_family(
    family: ColumnFamily,
    joints: Sequence[MovableJoint],
    stated: Mapping[int, str] | None = None,
    numbers: Sequence[int] = (),
) -> Match:
    """Match the columns of a family to joints.

    Columns are matched by name, by the numbers that the file has ``stated`` of joints, by the number in the joint
    names, else by order: that of the ``numbers`` with which another family has all joints, where they have these.
    """
    if any(isinstance(key, str) for key in family.columns):
        columns = {joint.name: family.columns[joint.name] for joint in joints if joint.name in family.columns}
        return Match(family, columns, "the columns have the names of the joints")
    if None in family.columns:
        return Match(family, {joints[0].name: family.columns[None]} if len(joints) == 1 else {}, "there is one joint")
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
    # columns of some joints only have the numbers of those of all joints
    numbers = all_numbers if set(numbered) <= set(all_numbers) else list(numbered)
    order = next((list(chain.values()) for chain in chains if len(chain) == len(numbers)), None)
    joint_of = dict(zip(numbers, order or [joint.name for joint in joints], strict=False))
    matched = {joint_of[k]: column for k, column in numbered.items() if k in joint_of}
    names = list(matched)
    question = (
        f"the columns are numbered {min(numbered)} to {max(numbered)} and the joints are called {names[0]} to "
        f"{names[-1]}: is this order right?"
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


def is_increasing(column: Array) -> bool:
    """Return whether each value is larger than the one before."""
    return len(column) > 1 and len(finite_values(column)) == len(column) and bool((np.diff(column) > 0).all())


def finite_values(column: Array) -> Array:
    """Return the finite values; larger ones would overflow in a difference."""
    return column[np.abs(column) < _MAX_VALUE]


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


@dataclass(frozen=True)
class TimeColumn:
    """The column of the stamps (None: not found) and its unit; ``step`` is the median step in s."""

    column: str | None
    unit: str = "s"
    step: float = math.nan
    question: str = ""


def time_column(
    table: DataTable, column_families: Iterable[ColumnFamily], rows: int, ros: bool, *, nameless: bool = False
) -> TimeColumn:
    """Return the first increasing column of stamps, with its unit from its name, or from its step.

    Where the columns are ``nameless`` and several could be the time, the likeliest is taken.
    """
    stamps = _find_stamps(table, column_families, rows, nameless)
    if rows < 2 or stamps is None:
        return TimeColumn(None)
    name, unit, question = stamps
    column = table.columns[name]
    unit = unit or ("s" if ros else _epoch_unit(column))
    if unit is None:
        return _unit_from_step(name, column, question)
    return TimeColumn(name, unit, _median_step(column) * unit_factor(unit, "time", ""), question)


def _find_stamps(
    table: DataTable, column_families: Iterable[ColumnFamily], rows: int, nameless: bool
) -> tuple[str, str | None, str] | None:
    """Return the column of the stamps, by its name or else its values, the unit in its name, and a question."""
    clocks = [family for family in column_families if family.role == "time"]
    candidates = [(column, family.units.get(column)) for family in clocks for column in family.columns.values()]
    # the unit of a column type outweighs that in its name; columns of dates are candidates without a telling name
    candidates = [*((name, table.units.get(name, unit)) for name, unit in candidates), *table.units.items()]
    stamps = [(name, unit) for name, unit in candidates if len(table.columns[name]) == rows]
    if not stamps:
        return _find_clock(table, rows, nameless)
    name, unit = min(stamps, key=lambda stamp: not is_increasing(table.columns[stamp[0]]))
    column = finite_values(table.columns[name])
    steps = np.diff(column)  # equal ones are rows written twice, or reading says what to do with them
    if len(column) < rows or rows < 2 or (steps < 0).any():
        return name, unit, "the stamps do not increase everywhere: is there a better column?"
    return name, unit, "" if np.median(steps) > 0 else _LONG_FORMAT_QUESTION


def _unit_from_step(name: str, column: Array, question: str) -> TimeColumn:
    """Return the time column with the unit that follows from its median step."""
    step = _median_step(column)
    # a step that is usual in seconds is taken as such; other units are asked about
    if _MIN_STEP <= step <= _MAX_STEP or step == 0:
        return TimeColumn(name, "s", step, question)
    if _is_counter(column):
        unit_question = "it counts by one: ms, or samples (then `time: { rate: ... }`)?"
        return TimeColumn(name, "ms", 1e-3, unit_question)
    unit = next((x for x in ("ms", "us", "ns") if _MIN_STEP <= step * UNITS["time"][x] <= _MAX_STEP), "s")
    unit_question = f"the median step is {step:.4g}: is this {unit}?"
    return TimeColumn(name, unit, step * UNITS["time"][unit], "; ".join(filter(None, (question, unit_question))))


def _find_clock(table: DataTable, rows: int, several: bool) -> tuple[str, str | None, str] | None:
    """Return the column that increases in about equal steps, the unit in its name, and a question.

    Its name does not matter. Of ``several`` candidates, prefer one that does not count samples, and whose steps
    may be seconds.
    """
    clocks = []
    for name, column in table.columns.items():
        if len(column) == rows >= _MIN_CLOCK_SAMPLES and is_increasing(column):
            ratios = np.diff(column) / np.median(np.diff(column))
            # the median of the deviations ignores a few gaps, which the maximum bounds
            if ratios.max() < _GAP_RATIO and np.median(np.abs(ratios - 1)) < _MAX_STEP_DEVIATION:
                clocks.append(name)
    if not clocks or (len(clocks) > 1 and not several):
        return None

    def rank(name: str) -> tuple[bool, bool]:
        """Sample counters come last, and columns in seconds first."""
        column = table.columns[name]
        return _is_counter(column), not _MIN_STEP <= _median_step(column) <= _MAX_STEP

    ranked = sorted(clocks, key=rank)
    words = re.split("[^a-z]+", ranked[0].lower())
    question = "the only column that increases evenly: is it the time?"
    if ranked[1:]:
        question = f"it increases evenly, as {' and '.join(map(repr, ranked[1:]))} do: is it the time?"
    return ranked[0], next((unit for unit in UNITS["time"] if unit in words), None), question


def _is_counter(column: Array) -> bool:
    """Return whether stamps count samples, or ms."""
    return _median_step(column) == 1 and float(finite_values(column)[0]).is_integer()


def _epoch_unit(column: Array) -> str | None:
    """Return the unit in which the stamps count from 1970 (a year from 2001 to 2049); None where they do not."""
    start = float(finite_values(column).min(initial=np.inf))
    return next((unit for unit in ("s", "ms", "us", "ns") if 1e9 < start * UNITS["time"][unit] < 2.5e9), None)


def _median_step(column: Array) -> float:
    """Return the median step, nan where there is none."""
    steps = np.diff(finite_values(column))
    return float(np.median(steps)) if len(steps) else math.nan


def has_gaps(table: DataTable, time: TimeColumn) -> bool:
    """Return whether some step of the stamps is far longer than the median."""
    if time.column is None:
        return False
    column = table.columns[time.column]
    return bool(0 < _median_step(column) * _GAP_RATIO < np.diff(finite_values(column)).max(initial=0.0))


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
