"""Parses the names of columns: quantity, joint, number, unit, and whether it was measured or commanded."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from dynident.io.fields import UNITS

__all__ = ["ColumnFamily", "Named", "families", "is_commanded", "is_reference", "read_name", "tokens"]


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_ROLES: Mapping[str, frozenset[str]] = {  # the first that a name has is its role
    "acceleration": _words("ddq qdd acc accel acceleration accelerations ddtheta qddot beschleunigung"),
    "velocity": _words(
        "dq qd vel velocity velocities speed speeds qdot dtheta omega geschwindigkeit drehzahl vitesse velocidad"
    ),
    "current": _words("current currents cur curr iq amp amps ampere i strom courant corriente"),
    "torque": _words("tau torque torques effort efforts eff trq tq moment force forces drehmoment kraft couple"),
    "position": _words(
        "q pos position positions angle angles ang theta th phi enc encoder encoders qm winkel posicion posizione"
    ),
    "time": _words("t time times stamp stamps timestamp timestamps clock secs zeit temps tiempo tempo"),
}
_COMMANDED = _words(
    "cmd command commands commanded des desired target targets ref reference goal setpoint sp d nominal plan planned "
    "con control soll sollwert consigne"
)
_MEASURED = _words("meas measured actual act fb feedback msr real sensed raw state read ist istwert")
_FILTERED = _words("filt filtered smooth smoothed est estimated hat lp")
_OTHER = _words(
    "err error errors ext external fric friction grav gravity model coriolis comp diff std var temp temperature limit "
    "max min ff feedforward residual res"
)
_STATE = _words("observation state")  # as LeRobot names the positions
_UNITS: Mapping[str, Mapping[str, str]] = {  # how a unit is spelled in lower case, and its name in a configuration
    "time": {
        **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
        **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
        **dict.fromkeys(("us", "usec", "µs", "micros", "microseconds"), "us"),
        **dict.fromkeys(("ns", "nsec", "nanos", "nanosec", "nanoseconds"), "ns"),
    },
    "position": {
        **dict.fromkeys(("rad", "radian", "radians"), "rad"),
        **dict.fromkeys(("deg", "degree", "degrees", "°"), "deg"),
        **dict.fromkeys(("rev", "revs"), "rev"),
        **{unit: unit for unit in ("mrad", "m", "mm", "cm", "um")},
    },
    "torque": {"nm": "N m", "mnm": "mN m", "knm": "kN m", "ncm": "N cm", "n": "N", "kn": "kN"},
    "current": {"a": "A", "amp": "A", "amps": "A", "ma": "mA"},
}
_TELLING = {  # units that tell the role too
    **dict.fromkeys(("deg", "rad", "°", "degrees", "mrad"), "position"),
    **dict.fromkeys(("nm", "mnm"), "torque"),
    "ma": "current",
}
_UNIT = re.compile(
    r"[\[(]\s*(?P<bracket>[^\W\d][^\])\d]*|°)\s*[\])]|(?<=[\W_])(?P<tail>[^\W\d_]+|°)(?=[\W_]*\d*[\W_]*$)"
)
_BREAK = re.compile(r"[\W_]+|(?<=[a-z])(?=[A-Z][a-z])|(?<=[^\W\d])(?=\d)|(?<=\d)(?=[^\W\d])")


@dataclass(frozen=True)
class Named:
    """The parsed name of a column; ``family`` is what it shares with the same quantity of other joints."""

    column: str
    role: str
    joint: str | None
    number: int | None
    unit: str | None
    family: tuple[str, ...]
    rank: int  # 1 measured, 0 not said, -1 filtered, -2 commanded or something derived


@dataclass(frozen=True)
class ColumnFamily:
    """Columns of one quantity, by joint or by number; None is the key of a column without either.

    ``units`` has the unit of each column whose name says it.
    """

    role: str
    rank: int
    columns: Mapping[str | int | None, str]
    units: Mapping[str, str] = field(default_factory=dict)


def tokens(name: str) -> tuple[str, ...]:
    """Return the words and numbers of a name, in lower case: ``tau_meas1`` and ``tauMeas[1]`` are tau, meas, 1."""
    return tuple(part.lower() for part in _BREAK.split(name) if part)


def read_name(column: str, joints: Iterable[str]) -> Named:
    """Parse a column's name, given the names of the robot's joints."""
    words = tokens(column)
    joint, rest = _joint(words, joints)
    spelled, unit_words = _unit(column)
    told = _TELLING.get(spelled, "")
    role = _role(rest) or (_role(words) if joint else "") or told or ("position" if set(words) >= _STATE else "")
    role = told if told and role == "time" else role  # T1 [Nm] is a torque
    unit = _UNITS.get(role, {}).get(spelled)
    if unit:
        rest = _without(rest, unit_words)
    number, rest = _number(rest) if joint is None else (None, rest)
    return Named(column, role, joint, number, unit, (*rest, unit or ""), _rank(set(rest)))


def _number(words: tuple[str, ...]) -> tuple[int | None, tuple[str, ...]]:
    """Return the last number among the words, and the others."""
    at = max((k for k, word in enumerate(words) if word.isdecimal()), default=None)
    return (None, words) if at is None else (int(words[at]), (*words[:at], *words[at + 1 :]))


def families(columns: Iterable[str], joints: Sequence[str]) -> list[ColumnFamily]:
    """Return the families of the columns, in the order of the file; those without a known role are left out."""
    alike: dict[tuple[object, ...], dict[str | int | None, Named]] = {}
    for one in (read_name(column, joints) for column in columns):
        if one.role:
            key = (one.role, one.unit, one.rank, one.family, one.joint is None, one.number is None)
            alike.setdefault(key, {}).setdefault(one.joint if one.joint is not None else one.number, one)
    found: list[dict[str | int | None, Named]] = []
    for members in alike.values():
        whole = next((other for other in found if _complete(other, members)), None)
        if whole is None:
            found.append(members)
        else:
            whole |= members
    return [_family(list(members.values()), list(members)) for members in found]


def _family(members: Sequence[Named], keys: Sequence[str | int | None]) -> ColumnFamily:
    return ColumnFamily(
        members[0].role,
        members[0].rank,
        {key: one.column for key, one in zip(keys, members, strict=True)},
        {one.column: one.unit for one in members if one.unit},
    )


def _complete(some: Mapping[str | int | None, Named], others: Mapping[str | int | None, Named]) -> bool:
    """Whether two families are one quantity of different joints, such as mm and deg, or N and N m.

    Columns that have numbers only must differ in the dimension of their unit.
    """
    if set(some) & set(others):
        return False
    one, other = (next(iter(members.values())) for members in (some, others))
    if (one.role, one.rank, _plain(one)) != (other.role, other.rank, _plain(other)):
        return False
    if one.joint is None or other.joint is None:
        numbered = one.number is not None and other.number is not None
        return numbered and "" != _dimension(one) != _dimension(other) != ""
    return True


def _plain(one: Named) -> tuple[str, ...]:
    """Return the words of a family without its unit, and without those for the role: force beside torque."""
    return tuple(word for word in one.family[:-1] if word not in _ROLES.get(one.role, ()))


def _dimension(one: Named) -> str:
    return next((dimension for dimension, known in UNITS.items() if one.unit in known), "")


def _joint(words: tuple[str, ...], joints: Iterable[str]) -> tuple[str | None, tuple[str, ...]]:
    """Return the joint with the longest name that the words hold in a row, and the other words."""
    for joint in sorted(joints, key=lambda name: -len(tokens(name))):
        name = tokens(joint)
        for k in range(len(words) - len(name) + 1):
            if name and words[k : k + len(name)] == name:
                return joint, (*words[:k], *words[k + len(name) :])
    return None, words


def _role(words: Sequence[str]) -> str:
    """Return the first role given by a word; a single letter t or i counts only if it is the whole name."""
    said = [word for word in words if not word.isdecimal()]
    for role, known in _ROLES.items():
        if any(word in known and (word not in ("t", "i") or said[0] == word) for word in said):
            return role
    return ""


def _unit(column: str) -> tuple[str, tuple[str, ...]]:
    """Return the unit in brackets or at the end of a name, in lower case, and its words."""
    found = list(_UNIT.finditer(column))
    if not found:
        return "", ()
    text = found[-1]["bracket"] or found[-1]["tail"]
    return re.sub(r"[\s*·.]", "", text).lower(), tokens(text)


def _without(words: tuple[str, ...], some: tuple[str, ...]) -> tuple[str, ...]:
    left = list(words)
    for word in some:
        if word in left:
            left.reverse()
            left.remove(word)
            left.reverse()
    return tuple(left)


def is_commanded(column: str) -> bool:
    """Return whether a column is named as what a controller was given, such as a reference."""
    return bool(set(tokens(column)) & _COMMANDED)


def is_reference(column: str, joints: Iterable[str]) -> bool:
    """Return whether a column is named as the position that a controller was to follow."""
    return is_commanded(column) and read_name(column, joints).role == "position"


def _rank(words: set[str]) -> int:
    if words & (_COMMANDED | _OTHER):
        return -2
    return int(bool(words & _MEASURED)) - int(bool(words & _FILTERED))
