"""Matches the columns of a recording to the joints of a robot: by name, by number, or by order."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dynident.io.columns import ColumnFamily, tokens
from dynident.io.fields import UNITS
from dynident.io.tables import DataTable
from dynident.models.robot_file import Limits

__all__ = ["JointFacts", "Match", "best_pair", "finite", "headerless", "increases", "rows_of", "turn"]

Array = NDArray[np.float64]
_LARGEST = 1e100
_JUMP, _WHOLE = 0.9, 0.97  # turns: the step of an angle that starts anew, and the range of its values


@dataclass(frozen=True)
class JointFacts:
    """A joint of the robot file that may move; ``follows`` names what couples it to other joints."""

    name: str
    kind: str
    limits: Limits = field(default_factory=Limits)
    follows: str = ""


@dataclass(frozen=True)
class Match:
    """Columns of a family by joint, how they were matched, and a question whether that is right."""

    family: ColumnFamily
    columns: Mapping[str, str]
    reason: str
    question: str = ""


def headerless(table: DataTable, count: int) -> list[ColumnFamily]:
    """Return families for columns 0, 1, ...: time first, then positions, perhaps velocities, and torques."""
    names = list(table.columns)
    if not names or not all(name.isdecimal() for name in names):
        return []
    clocks = [name for name in names if increases(table.columns[name])]  # of several, their values tell
    first = [ColumnFamily("time", 0, {None: names[0]})] if clocks == names[:1] else []
    rest = names[len(first) :]
    if len(rest) not in (2 * count, 3 * count):
        return first
    parts = (rest[:count], rest[-count:])
    return [
        *first,
        *(
            ColumnFamily(role, 0, dict(enumerate(part)))
            for role, part in zip(("position", "torque"), parts, strict=True)
        ),
    ]


def best_pair(
    table: DataTable, found: Iterable[ColumnFamily], joints: Sequence[JointFacts]
) -> tuple[Match | None, Match | None]:
    """Return the columns of positions and of torques: of equal length, for the most joints, measured, unfiltered.

    Commanded quantities are never used, currents only where there are no torques.
    """
    said = _said(table, joints)
    sound = [one for one in (assign(family, joints, said) for family in found if family.rank > -2) if one.columns]
    positions, torques = (_of_role(sound, *roles) for roles in (("position",), ("torque", "current")))
    pairs = (pair for pair in product([*positions, None], [*torques, None]) if _alike(table, pair))
    position, torque = max(pairs, key=_merit, default=(None, None))
    return _rivals(table, position, positions), _rivals(table, torque, torques)


def _of_role(matches: Iterable[Match], *roles: str) -> list[Match]:
    return [one for one in matches if one.family.role in roles]


def _alike(table: DataTable, pair: tuple[Match | None, Match | None]) -> bool:
    """Whether there are columns, and all of one length."""
    return len({rows_of(table, one) for one in pair if one}) == 1


def _merit(pair: tuple[Match | None, Match | None]) -> tuple[float, ...]:
    """Return the sort key of a pair of positions and torques, the most important criterion first."""
    given = [one for one in pair if one]
    common = set.intersection(*(set(one.columns) for one in given))
    return (
        len(given) if common else 0,
        len(common),
        sum(one.family.rank for one in given),
        any(one.family.role == "torque" for one in given),
        -sum(bool(one.question) for one in given),
        pair[0] is not None,
    )


def _rivals(table: DataTable, chosen: Match | None, others: Iterable[Match]) -> Match | None:
    """Return the match with a question, where other columns have equivalent names for as many joints."""
    if chosen is None:
        return None
    key = chosen.family.role, chosen.family.rank, set(chosen.columns), rows_of(table, chosen)
    equal = [
        next(iter(one.columns.values()))
        for one in others
        if one is not chosen and (one.family.role, one.family.rank, set(one.columns), rows_of(table, one)) == key
    ]
    asked = f"why not {' or '.join(map(repr, equal))}, whose name has the same meaning?" if equal else ""
    return replace(chosen, question="; ".join(filter(None, (chosen.question, asked))))


def _said(table: DataTable, joints: Sequence[JointFacts]) -> dict[int, str]:
    """Return the joints that columns of text name in all rows, by the number in the names of these columns."""
    names = {joint.name for joint in joints}
    known = {column: joint for column, joint in table.texts.items() if joint in names}
    found = {int(words[-1]): joint for column, joint in known.items() if (words := tokens(column))[-1].isdecimal()}
    return found if len(set(found.values())) == len(known) else {}


def assign(family: ColumnFamily, joints: Sequence[JointFacts], said: Mapping[int, str] | None = None) -> Match:
    """Match the columns of a family to joints: by name, by what the file has ``said`` of numbers, by the number in the
    joints' names, else by order."""
    if any(isinstance(key, str) for key in family.columns):
        columns = {joint.name: family.columns[joint.name] for joint in joints if joint.name in family.columns}
        return Match(family, columns, "the columns have the names of the joints")
    if None in family.columns:
        return Match(family, {joints[0].name: family.columns[None]} if len(joints) == 1 else {}, "there is one joint")
    numbers = sorted(key for key in family.columns if isinstance(key, int))
    if said and set(said) <= set(numbers):
        return Match(family, {joint: family.columns[k] for k, joint in said.items()}, "the file names the joints")
    return _by_number(family, {key: family.columns[key] for key in numbers}, joints)


def _by_number(family: ColumnFamily, numbered: Mapping[int, str], joints: Sequence[JointFacts]) -> Match:
    """Match numbered columns to the joints whose names have these numbers, else to as many joints in order."""
    chains = _chains(joints)
    for chain in chains:
        if sorted(chain) == list(numbered):
            by_number = {chain[k]: column for k, column in numbered.items()}
            return Match(family, by_number, "matched by the number in the joints' names")
    order = next((list(chain.values()) for chain in chains if len(chain) == len(numbered)), None)
    return _in_order(family, numbered, order or [joint.name for joint in joints])


def _in_order(family: ColumnFamily, columns: Mapping[int, str], order: Sequence[str]) -> Match:
    """Match numbered columns to joints in this order, with the question whether that is right."""
    numbers, matched = list(columns), dict(zip(order, columns.values(), strict=False))
    return Match(
        family,
        matched,
        "matched by order",
        f"the columns are numbered {numbers[0]} to {numbers[-1]} and the joints are called {order[0]} to "
        f"{order[len(matched) - 1]}: is this order right?",
    )


def _chains(joints: Iterable[JointFacts]) -> list[dict[int, str]]:
    """Return the joints whose names differ in their last number only, by that number; the longest chain first."""
    chains: dict[tuple[str, ...], dict[int, str]] = {}
    for joint in joints:
        words = tokens(joint.name)
        at = max((k for k, word in enumerate(words) if word.isdecimal()), default=None)
        if at is not None:
            chains.setdefault((*words[:at], "", *words[at + 1 :]), {}).setdefault(int(words[at]), joint.name)
    return sorted(({k: one[k] for k in sorted(one)} for one in chains.values()), key=len, reverse=True)


def rows_of(table: DataTable, match: Match | None) -> int:
    """Return the length of the columns matched; None: of the first column, or 0."""
    columns = list(match.columns.values()) if match else list(table.columns)
    return len(table.columns[columns[0]]) if columns else 0


def increases(column: Array) -> bool:
    """Return whether each value is larger than the one before."""
    return len(column) > 1 and len(finite(column)) == len(column) and bool((np.diff(column) > 0).all())


def finite(column: Array) -> Array:
    """Return the finite values; larger ones would overflow in a difference."""
    return column[np.abs(column) < _LARGEST]


def turn(q: Array, unit: str) -> float | None:
    """Return the turn after which an angle starts anew, in its unit (rad or degrees where it has none); None if not."""
    known = UNITS["angle"]
    sizes = [2 * math.pi / known[unit]] if unit in known else [2 * math.pi, 360.0]
    steps, span = np.abs(np.diff(q)), float(np.ptp(q)) if len(q) else 0.0
    for size in sizes:
        jumps = steps > _JUMP * size
        if jumps.any() and _WHOLE * size < span < size * (1 + 1e-6) and steps[~jumps].max(initial=0.0) < 0.25 * size:
            return round(size, 12)
    return None
