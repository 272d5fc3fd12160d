"""Guesses at a configuration from the names and values of columns: each with its reason, or a question where unsure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dynident.io.columns import Family, families, tokens
from dynident.io.fields import UNITS
from dynident.io.settings import POSITIONS, TORQUES
from dynident.io.tables import Table
from dynident.terms.robot_xml import Limits

__all__ = ["Guess", "JointFacts", "Signal", "TimeGuess", "guess", "widths"]

Array = NDArray[np.float64]

_DECIMALS = 6  # of locked positions: more than any gripper is known to
_STILL = 1e-3  # rad or m: a locked joint that moves more is asked about
_SLACK = 1.05  # on limits of position
_OVER, _UNDER = 1.5, 0.02  # times the effort limit: torques beyond are hardly joint torques
_FASTEST, _SLOWEST = 5e-5, 0.3  # s: sampling steps that are taken for granted
_GAP = 12  # times the median step, as in the reading of logs


@dataclass(frozen=True)
class JointFacts:
    """A joint that may move, as the robot file has it; ``follows`` names what binds it to other joints."""

    name: str
    kind: str
    limits: Limits = Limits()
    follows: str = ""


@dataclass(frozen=True)
class Signal:
    """A channel of a joint: its column (None: not found), its unit, and why, or what is to be confirmed."""

    column: str | None
    unit: str
    question: str = ""
    gain: str = ""  # what the gain is, where the column is no torque yet


@dataclass(frozen=True)
class TimeGuess:
    """The column of the stamps (None: not found) and its unit; ``step`` is the median step in s."""

    column: str | None
    unit: str = "s"
    step: float = math.nan
    question: str = ""


@dataclass(frozen=True)
class Guess:
    """Channels by joint, in the order of the robot file; joints that stand still, and at which position.

    ``reasons`` tell how the columns of "position" and "torque" were matched; ``left`` are columns of the same length
    that are not used; ``gaps`` says whether the stamps have any.
    """

    time: TimeGuess
    position: Mapping[str, Signal]
    torque: Mapping[str, Signal]
    lock: Mapping[str, tuple[float, str]]
    reasons: Mapping[str, str]
    left: tuple[str, ...]
    gaps: bool


@dataclass(frozen=True)
class _Match:
    """Columns of a family by joint, how they were matched, and the question whether that is right."""

    columns: Mapping[str, str]
    reason: str
    question: str = ""


def widths(tables: Mapping[str, Table]) -> dict[str, int]:
    """Return the widths of those text files, of one recording, that hold one number a line and several per stamp.

    The shortest column has one number per stamp; the others must hold a multiple.
    """
    lengths = {key: len(next(iter(one.columns.values()))) for key, one in tables.items() if len(one.columns) == 1}
    shortest = min(lengths.values(), default=0)
    return {key: n // shortest for key, n in lengths.items() if n > shortest and n % shortest == 0}


def guess(table: Table, joints: Sequence[JointFacts], ros: bool = False) -> Guess:
    """Guess the channels of a recording for the joints of a robot; ``ros``: the units are those of JointState.

    Never raises for want of a guess: what is not found is None, what is unsure carries a question.
    """
    usable = [joint for joint in joints if not joint.follows]
    found = families(table.columns, [joint.name for joint in joints]) or _headerless(table, len(usable))
    pair = _pair(table, found, usable)
    position, torque = (_match(family, usable) if family else None for family in pair)
    names = _shared(position, torque, usable)
    used = [joint for joint in usable if joint.name in names]
    rows = _rows(table, position or torque)
    time = _time(table, found, rows, ros)
    matched = [joint for joint in usable if position is None or joint.name in position.columns]
    signals = _positions(table, matched, position, pair[0], ros)
    taken = {time.column, *(column for match in (position, torque) if match for column in match.columns.values())}
    return Guess(
        time=time,
        position={joint.name: signals.get(joint.name, _unknown(joint, POSITIONS)) for joint in used},
        torque=_torques(table, used, torque, pair[1]),
        lock=_lock(table, joints, names, signals if position else {}),
        reasons={key: match.reason for key, match in (("position", position), ("torque", torque)) if match},
        left=tuple(name for name in table.columns if name not in taken and len(table.columns[name]) == rows),
        gaps=_has_gaps(table, time),
    )


def _headerless(table: Table, count: int) -> list[Family]:
    """Return families for columns 0, 1, ...: time first, then positions, perhaps velocities, and torques."""
    names = list(table.columns)
    if not all(name.isdecimal() for name in names) or count == 0:
        return []
    first = [Family("time", None, 0, {None: names[0]})] if _increases(table.columns[names[0]]) else []
    rest = names[len(first) :]
    if len(rest) not in (2 * count, 3 * count):
        return first
    parts = (rest[:count], rest[-count:])
    return [
        *first,
        *(
            Family(role, None, 0, dict(enumerate(part)))
            for role, part in zip(("position", "torque"), parts, strict=True)
        ),
    ]


def _pair(
    table: Table, found: Iterable[Family], joints: Sequence[JointFacts]
) -> tuple[Family | None, Family | None]:
    """Return the families of positions and of torques: of equal length, for the most joints, measured, unfiltered."""
    sound = [one for one in found if one.rank > -2]
    positions = [one for one in sound if one.role == "position"]
    torques = [one for one in sound if one.role in ("torque", "current")]
    best: tuple[Family | None, Family | None] = (None, None)
    most: tuple[float, ...] = (0,)
    for one, other in product([*positions, None], [*torques, None]):
        matched = [_match(family, joints) for family in (one, other) if family]
        if not matched or (one and other and _rows(table, matched[0]) != _rows(table, matched[1])):
            continue
        common = set.intersection(*(set(match.columns) for match in matched))
        merit = (
            len(matched) if common else 0,
            len(common),
            sum(family.rank for family in (one, other) if family),
            bool(other and other.role == "torque"),
            -sum(bool(match.question) for match in matched),
            bool(one),
        )
        if merit > most:
            best, most = (one, other), merit
    return best


def _match(family: Family, joints: Sequence[JointFacts]) -> _Match:
    """Match the columns of a family to joints: by name, by the number in the joints' names, else by order."""
    named = {key: column for key, column in family.columns.items() if isinstance(key, str)}
    if named:
        columns = {joint.name: named[joint.name] for joint in joints if joint.name in named}
        return _Match(columns, "the columns carry the names of the joints")
    if None in family.columns:
        return _Match({joints[0].name: family.columns[None]} if len(joints) == 1 else {}, "there is one joint")
    numbers = sorted(key for key in family.columns if isinstance(key, int))
    for chain in _chains(joints):
        if sorted(chain) == numbers:
            return _Match({chain[k]: family.columns[k] for k in numbers}, "matched by the number in the joints' names")
    order = next((list(chain.values()) for chain in _chains(joints) if len(chain) == len(numbers)), None)
    order = order or [joint.name for joint in joints]
    columns = dict(zip(order, (family.columns[k] for k in numbers), strict=False))
    return _Match(
        columns,
        "matched by order",
        f"the columns are numbered {numbers[0]} to {numbers[-1]} and the joints are called {order[0]} to "
        f"{order[len(columns) - 1]}: is this order right?",
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


def _shared(one: _Match | None, other: _Match | None, joints: Sequence[JointFacts]) -> set[str]:
    """Return the joints to identify: those with position and torque, or with what was found of the two."""
    matched = [set(match.columns) for match in (one, other) if match and match.columns]
    return set.intersection(*matched) if matched else {joint.name for joint in joints}


def _rows(table: Table, match: _Match | None) -> int:
    columns = list(match.columns.values()) if match else list(table.columns)
    return len(table.columns[columns[0]]) if columns else 0


def _positions(
    table: Table, joints: Sequence[JointFacts], match: _Match | None, family: Family | None, ros: bool
) -> dict[str, Signal]:
    if match is None or family is None:
        return {joint.name: _unknown(joint, POSITIONS) for joint in joints}
    values = {joint.name: _finite(table.columns[match.columns[joint.name]]) for joint in joints}
    fits = all(_fits(joint, values[joint.name], 1.0) for joint in joints)
    degrees = not fits and all(
        _fits(joint, values[joint.name], math.pi / 180) for joint in joints if joint.kind == "revolute"
    )
    found = {}
    for joint in joints:
        known = UNITS[POSITIONS[joint.kind]]
        unit = family.unit if family.unit in known else None
        question = match.question
        if unit is None:
            unit = "deg" if degrees and not ros and joint.kind == "revolute" else _si(joint, POSITIONS)
            doubt = _doubt(joint, values[joint.name], degrees and not ros)
            question = "; ".join(filter(None, (question, doubt)))
        found[joint.name] = Signal(match.columns[joint.name], unit, question)
    return found


def _fits(joint: JointFacts, q: Array, factor: float) -> bool:
    """Whether positions times ``factor``, in rad or m, are what the joint can do."""
    low, high = factor * float(q.min(initial=0.0)), factor * float(q.max(initial=0.0))
    lower, upper = joint.limits.lower, joint.limits.upper
    if lower is not None and upper is not None and lower < upper:
        slack = (_SLACK - 1) * (upper - lower)
        return lower - slack <= min(low, upper) and max(high, lower) <= upper + slack
    return high - low <= (2 * math.pi if joint.kind == "revolute" else 10.0)


def _doubt(joint: JointFacts, q: Array, degrees: bool) -> str:
    """Return what is to be asked about a position whose unit is not in its name."""
    span = float(np.ptp(q)) if len(q) else 0.0
    low, high = (f"{x:.3g}" for x in (q.min(initial=0.0), q.max(initial=0.0)))
    if joint.kind == "prismatic":
        return "" if _fits(joint, q, 1.0) else f"{low} to {high} is more than the joint can do in m: mm?"
    if degrees:
        return f"{low} to {high}: is this degrees? Or a motor before its gear, in rad (then `transmission`)?"
    if _fits(joint, q, 1.0):
        return "" if span > 0.02 or span == 0 else f"the joint moves by {span:.2g} only: rad?"
    if joint.limits.lower is None and span > 2 * math.pi:
        return f"the range {span:.3g} exceeds 2 pi: does it turn so far (then `multi_turn: true`), or is it degrees?"
    return f"{low} to {high} is beyond what the joint can do in rad: degrees, encoder counts, another zero, or a motor?"


def _unknown(joint: JointFacts, dimensions: Mapping[str, str]) -> Signal:
    """Return a channel without a column, in SI."""
    return Signal(None, _si(joint, dimensions))


def _si(joint: JointFacts, dimensions: Mapping[str, str]) -> str:
    return next(unit for unit, factor in UNITS[dimensions[joint.kind]].items() if factor == 1)


def _torques(
    table: Table, joints: Sequence[JointFacts], match: _Match | None, family: Family | None
) -> dict[str, Signal]:
    units = {joint.name: _si(joint, TORQUES) for joint in joints}
    if match is None or family is None:
        return {name: Signal(None, unit) for name, unit in units.items()}
    if family.role == "current":
        per = f"per {family.unit}" if family.unit else "per A or mA"
        return {
            name: Signal(match.columns[name], unit, match.question, f"torque constant times gear ratio, {unit} {per}")
            for name, unit in units.items()
        }
    peaks = {joint.name: float(np.abs(_finite(table.columns[match.columns[joint.name]])).max(initial=0.0)) for joint in joints}
    limits = {joint.name: joint.limits.effort for joint in joints if joint.limits.effort}
    ratios = {name: peaks[name] / limit for name, limit in limits.items() if limit}
    found = {}
    for joint in joints:
        named = family.unit in UNITS[TORQUES[joint.kind]]
        unit = str(family.unit) if named else units[joint.name]
        doubt = ""
        if not named and ratios.get(joint.name, 0.0) > _OVER:
            doubt = (
                f"the peak {peaks[joint.name]:.3g} exceeds the limit {limits[joint.name]:.3g} {unit} of the robot file: "
                "is it a current in mA, or another unit?"
            )
        elif not named and ratios and max(ratios.values()) < _UNDER:
            doubt = (
                f"the peak {peaks[joint.name]:.2g} is small against the limit of the robot file: is it the motor's, before "
                "the gear, or a current? Then `gain`."
            )
        found[joint.name] = Signal(match.columns[joint.name], unit, "; ".join(filter(None, (match.question, doubt))))
    return found


def _time(table: Table, found: Iterable[Family], rows: int, ros: bool) -> TimeGuess:
    """Return the first column of stamps that increases, with its unit: from its name, or from its step."""
    named = [(column, one.unit) for one in found if one.role == "time" for column in one.columns.values()]
    stamps = [(name, unit) for name, unit in named if len(table.columns[name]) == rows]
    stamps.sort(key=lambda stamp: not _increases(table.columns[stamp[0]]))
    if not stamps or rows < 2:
        return TimeGuess(None)
    name, unit = stamps[0]
    column = table.columns[name]
    step = float(np.nanmedian(np.diff(column)))
    question = "" if _increases(column) else "the stamps do not increase everywhere: is there a better column?"
    if ros and unit is None:
        unit = "s"
    if unit is not None:
        return TimeGuess(name, unit, step * UNITS["time"][unit], question)
    if _FASTEST <= step <= _SLOWEST:
        return TimeGuess(name, "s", step, question)
    if step == 1 and float(column[0]).is_integer():
        asked = "it counts by one: ms, or samples (then `time: { rate: ... }`)?"
        return TimeGuess(name, "ms", 1e-3, asked)
    unit = next((x for x in ("ms", "us", "ns") if _FASTEST <= step * UNITS["time"][x] <= _SLOWEST), "s")
    asked = f"the median step is {step:.4g}: is this {unit}?"
    return TimeGuess(name, unit, step * UNITS["time"][unit], "; ".join(filter(None, (question, asked))))


def _increases(column: Array) -> bool:
    return len(column) > 1 and bool((np.diff(column) > 0).all())


def _finite(column: Array) -> Array:
    return column[np.isfinite(column)]


def _has_gaps(table: Table, time: TimeGuess) -> bool:
    if time.column is None:
        return False
    steps = np.diff(table.columns[time.column])
    return bool((steps > _GAP * np.nanmedian(steps)).any())


def _lock(
    table: Table, joints: Sequence[JointFacts], used: set[str], recorded: Mapping[str, Signal]
) -> dict[str, tuple[float, str]]:
    """Return where the joints stand that are not identified, in rad or m, and what is to be asked about it.

    A joint that follows one that stands still needs no value.
    """
    lock: dict[str, tuple[float, str]] = {}
    for joint in joints:
        unit = "rad" if joint.kind == "revolute" else "m"
        if joint.name in used or (joint.follows and joint.follows not in used):
            continue
        signal = recorded.get(joint.name)
        if joint.follows:
            lock[joint.name] = 0.0, f"it follows {joint.follows!r}, which moves: a model cannot have both"
        elif signal is not None and signal.column is not None:
            q = _finite(table.columns[signal.column]) * UNITS[POSITIONS[joint.kind]][signal.unit]
            moves = f"it moves by {np.ptp(q):.2g} {unit} in the log" if len(q) and np.ptp(q) > _STILL else ""
            lock[joint.name] = round(float(np.median(q)), _DECIMALS) + 0.0 if len(q) else 0.0, moves
        else:
            low = -math.inf if joint.limits.lower is None else joint.limits.lower
            high = math.inf if joint.limits.upper is None else joint.limits.upper
            value = min(max(0.0, low), high)
            lock[joint.name] = value, f"it is not in the log: where does it stand ({unit})?"
    return lock
