"""Parser of column names: quantity, joint, number, unit, and whether it was measured or commanded."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from dynident.project.fields import FACTOR, UNITS

_UNITS: Mapping[str, Mapping[str, str]] = {  # how a unit is spelled in lower case, and its name in a configuration
    "time": {
        **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
        **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
        **dict.fromkeys(("us", "usec", "µs", "micros", "microseconds"), "us"),
        **dict.fromkeys(("ns", "nsec", "nanos", "nanosec", "nanoseconds"), "ns"),
        **dict.fromkeys(("min", "mins", "minutes"), "min"),
    },
    "position": {
        **dict.fromkeys(("rad", "radian", "radians"), "rad"),
        **dict.fromkeys(("deg", "degree", "degrees", "grad", "°"), "deg"),
        **dict.fromkeys(("rev", "revs"), "rev"),
        **{unit: unit for unit in ("mrad", "m", "mm", "cm", "um")},
    },
    "torque": {
        "nm": "N m",
        "mnm": "mN m",
        "nmm": "N mm",
        "knm": "kN m",
        "ncm": "N cm",
        "n": "N",
        "kn": "kN",
        **{unit.replace(" ", ""): unit for unit in ("kgf m", "kgf cm", "lbf ft", "lbf in", "kgf", "lbf")},
    },
    "current": {"a": "A", "amp": "A", "amps": "A", "ma": "mA", "%": "%"},
}
_UNIT_ROLES = {  # units that tell the role too
    **dict.fromkeys(("deg", "rad", "°", "degrees", "grad", "mrad", "mm", "um"), "position"),
    **dict.fromkeys(("nm", "mnm", "nmm"), "torque"),
    "ma": "current",
}
_UNIT = re.compile(
    r"[\[(]\s*(?P<bracket>[^\W\d][^\])\d]*|[°%])\s*[\])]|(?<=[\W_])(?P<tail>[^\W\d_]{2,}|[°%aA])(?=[\W_]*\d*[\W_]*$)"
    r"|(?<=[\W_])(?P<letter>[^\W\d_])(?=[\W_]*$)"  # the m of enc_m1 is a motor
)
_STATED = re.compile(rf"\[\s*((?:{FACTOR}\s*)?[^\]\d]+?)\s*\]|(%|percent)", re.IGNORECASE)
_FACTOR_AND_UNIT = re.compile(rf"([\[(])\s*({FACTOR})\s*((?:[^\W\d]|[°%])[^\])\d]*[\])])")
_COMPOUND_NOUNS = (  # that end words such as Motorstrom, Istwinkel, jointtorque, 关节角度
    "angle position velocity speed acceleration torque effort current winkel geschwindigkeit drehzahl beschleunigung "
    "moment kraft strom zeit 角度 位置 速度 加速度 力矩 扭矩 转矩 电流 时间"
)
_WORD_BREAK = re.compile(
    r"[\W_]+|(?<=[a-z])(?=[A-Z][a-z])|(?<=[A-Z]{2})(?=[A-Z][a-z])|(?<=[^\W\d])(?=\d)|(?<=\d)(?=[^\W\d])"
    rf"|(?<=[^\W\d_])(?<!加)(?=(?i:{'|'.join(_COMPOUND_NOUNS.split())})(?![^\W\d_]))"
)


def _word_set(text: str) -> frozenset[str]:
    return frozenset(text.split())


_ROLES: Mapping[str, frozenset[str]] = {  # the first that a name has is its role
    "acceleration": _word_set(
        "ddq qdd ddot qacc acc accel acceleration accelerations ddtheta qddot beschleunigung 加速度"
    ),
    "velocity": _word_set(
        "dq qd dot qvel vel velocity velocities speed speeds qdot dtheta omega geschwindigkeit drehzahl vitesse "
        "velocidad 速度"
    ),
    "current": _word_set("current currents cur curr iq amp amps ampere i strom courant corriente 电流 電流 電流値"),
    "torque": _word_set(
        "tau qfrc torque torques effort efforts eff trq tq moment force forces kraft couple 力矩 扭矩 转矩 トルク"
    ),
    "position": _word_set(
        "q qpos pos position positions angle angles ang theta th phi enc encoder encoders pulse pulses qm winkel "
        "posicion posizione 角度 位置"
    ),
    "time": _word_set("t ts time times tout stamp stamps timestamp timestamps clock secs zeit temps tiempo tempo 时间"),
}
_COMMANDED_WORDS = _word_set(
    "cmd command commands commanded des desired target targets ref reference goal setpoint sp d nominal plan planned "
    "con control soll sollwert consigne action actions 指令 期望 目标 给定 参考"
)
_CONTROL_WORDS = _word_set("con control")
_MEASURED_WORDS = _word_set(
    "meas measured actual act fb feedback msr real sensed raw state read ist istwert 实际 测量 反馈"
)
_FILTERED_WORDS = _word_set("filt filtered smooth smoothed est estimated computed hat lp")
_DERIVED_WORDS = _word_set(
    "err error errors ext external fric friction grav gravity model coriolis comp diff std var temp temperature limit "
    "max min ff feedforward residual res tcp ee eef wrench cartesian ft dstb dist disturbance collision "
    "bias passive constraint inverse"
)
_AFTER_PRESENT = _word_set("pos position positions angle angles torque torques effort efforts")
COMMANDED = -2  # the rank of what was commanded or derived, not measured
_LOAD_WORDS = _word_set("load auslastung")  # of a motor, in %
_POSITION_PHRASES = _word_set("observation state"), _word_set("axis act")  # of LeRobot, and of the traces of KUKA


@dataclass(frozen=True)
class ColumnName:
    """The parsed name of a column; ``family`` is the part it shares with the same quantity of other joints."""

    column: str
    role: str
    joint: str | None
    number: int | None
    unit: str | None
    family: tuple[str, ...]
    rank: int  # 1 measured, 0 not said, -1 filtered, COMMANDED


@dataclass(frozen=True)
class ColumnFamily:
    """Columns of one quantity, by joint or by number; the key of a column without either is None.

    ``units`` has the unit of each column whose name contains it.
    """

    role: str
    rank: int
    columns: Mapping[str | int | None, str]
    units: Mapping[str, str] = field(default_factory=dict)


def tokens(name: str) -> tuple[str, ...]:
    """Return the words and numbers of a name, in lower case: ``tau_meas1`` and ``tauMeas[1]`` are tau, meas, 1."""
    return tuple(part.lower() for part in _WORD_BREAK.split(name) if part)


def read_name(column: str, joints: Iterable[str]) -> ColumnName:
    """Parse a column's name, given the names of the robot's joints."""
    factor = _FACTOR_AND_UNIT.search(column)
    text = _FACTOR_AND_UNIT.sub(r"\1\3", column)  # the number is none of a joint
    words = tokens(text)
    # the joint is taken out first: its name may contain words such as torque or position
    joint, remaining = _take_joint(words, joints)
    unit_spelling, unit_words = _unit_in_name(text)
    unit_role = _UNIT_ROLES.get(unit_spelling, "")
    role = (
        _find_role(remaining)
        or next(filter(None, (_find_role(tokens(part)) for part in re.split("[./]", text))), "")  # log.I_mot.Data
        or (_find_role(words) if joint else "")
        or unit_role
        or ("current" if unit_spelling == "%" and _LOAD_WORDS & set(words) else "")
        or ("position" if any(phrase <= set(words) for phrase in _POSITION_PHRASES) else "")
    )
    role = unit_role if unit_role and role == "time" else role  # T1 [Nm] is a torque
    unit = _UNITS.get(role, {}).get(unit_spelling)
    if unit:
        remaining = _remove_words(remaining, unit_words)
        unit = f"{factor[2].replace(',', '.')} {unit}" if factor else unit
    number, remaining = _take_number(remaining) if joint is None else (None, remaining)
    return ColumnName(column, role, joint, number, unit, (*remaining, unit or ""), _measurement_rank(set(remaining)))


def _take_number(words: tuple[str, ...]) -> tuple[int | None, tuple[str, ...]]:
    """Return the last number among the words, and the others."""
    # the last number counts: earlier ones may belong to the robot, as in ur5_q1
    at = max((k for k, word in enumerate(words) if word.isdecimal()), default=None)
    return (None, words) if at is None else (int(words[at]), (*words[:at], *words[at + 1 :]))


def families(columns: Iterable[str], joints: Sequence[str]) -> list[ColumnFamily]:
    """Return the families of the columns, in the order of the file; columns without a known role are left out."""
    groups: dict[tuple[object, ...], dict[str | int | None, ColumnName]] = {}
    for name in (read_name(column, joints) for column in columns):
        # measured, filtered and commanded columns differ in their rank, and become families of their own
        if name.role:
            key = (name.role, name.unit, name.rank, name.family, name.joint is None, name.number is None)
            groups.setdefault(key, {}).setdefault(name.joint if name.joint is not None else name.number, name)
    # merge families of one quantity whose units differ by joint, as mm and deg
    merged: list[dict[str | int | None, ColumnName]] = []
    for members in groups.values():
        target = next((group for group in merged if _is_complement(group, members)), None)
        if target is None:
            merged.append(members)
        else:
            target |= members
    return [_family(list(members.values()), list(members)) for members in merged]


def _family(members: Sequence[ColumnName], keys: Sequence[str | int | None]) -> ColumnFamily:
    return ColumnFamily(
        members[0].role,
        members[0].rank,
        {key: name.column for key, name in zip(keys, members, strict=True)},
        {name.column: name.unit for name in members if name.unit},
    )


def _is_complement(
    group: Mapping[str | int | None, ColumnName], other_group: Mapping[str | int | None, ColumnName]
) -> bool:
    """Return whether two families are one quantity of different joints, as with mm and deg, or N and N m.

    Columns that have only numbers must differ in the dimension of their unit.
    """
    if set(group) & set(other_group):
        return False
    name, other_name = (next(iter(members.values())) for members in (group, other_group))
    if (name.role, name.rank, _bare_words(name)) != (other_name.role, other_name.rank, _bare_words(other_name)):
        return False
    # without joint names, two numbered families are merged only if their dimensions show that they are different joints
    if name.joint is None or other_name.joint is None:
        numbered = name.number is not None and other_name.number is not None
        return numbered and "" != _unit_dimension(name) != _unit_dimension(other_name) != ""
    return True


def _bare_words(name: ColumnName) -> tuple[str, ...]:
    """Return the words of a family without its unit and role words, so that force and torque compare equal."""
    return tuple(word for word in name.family[:-1] if word not in _ROLES.get(name.role, ()))


def _unit_dimension(name: ColumnName) -> str:
    return next((dimension for dimension, units in UNITS.items() if name.unit in units), "")


def _take_joint(words: tuple[str, ...], joints: Iterable[str]) -> tuple[str | None, tuple[str, ...]]:
    """Return the joint with the longest name that occurs in the words, and the remaining words.

    Where none occurs, names are compared without the words that all of them share, as in rf_knee_joint, then by their
    letters: joint_1_s is the S axis.
    """
    names = {joint: tokens(joint) for joint in joints}
    shared = set.intersection(*map(set, names.values())) if names else set()
    short_names = {joint: tuple(word for word in name if word not in shared) for joint, name in names.items()}
    # what remains must tell the joint: not a number or a letter, which other names have too
    short_names = {
        joint: name for joint, name in short_names.items() if any(len(word) > 2 and word.isalpha() for word in name)
    }
    letters = {joint: tuple(x for x in name if len(x) == 1 and x.isalpha()) for joint, name in names.items()}
    letters = letters if len({*letters.values()} - {()}) == len(names) and len(words) > 1 else {}
    for candidates in (names, short_names, letters):
        for joint, name in sorted(candidates.items(), key=lambda candidate: -len(candidate[1])):
            for k in range(len(words) - len(name) + 1):
                if name and words[k : k + len(name)] == name:
                    return joint, (*words[:k], *words[k + len(name) :])
    return None, words


def _find_role(words: Sequence[str]) -> str:
    """Return the first role given by a word; a single letter t or i counts only if it is the whole name."""
    texts = [word for word in words if not word.isdecimal()]
    # current_position is the present one, and actual_current_as_torque a torque; torque_current is a current
    noun = max((k for k, word in enumerate(texts) if word in _AFTER_PRESENT), default=0)
    texts = [word for k, word in enumerate(texts) if k >= noun or word != "current"]
    for role, role_words in _ROLES.items():
        if any(word in role_words and (word not in ("t", "i") or texts[0] == word) for word in texts):
            return role
    return ""


def _unit_in_name(column: str) -> tuple[str, tuple[str, ...]]:
    """Return the unit in brackets or at the end of a name, in lower case, and its words."""
    matches = list(_UNIT.finditer(column))
    if not matches:
        return "", ()
    texts = [next(filter(None, match.groups())) for match in matches]
    spellings = [(re.sub(r"[\s*·⋅.-]", "", text).lower(), tokens(text)) for text in texts]
    # the last that is a unit: a word may follow it, as in pos [rad] motor side
    return next((unit for unit in reversed(spellings) if any(unit[0] in x for x in _UNITS.values())), spellings[-1])


def stated_unit(column: str, joints: Iterable[str]) -> str:
    """Return what a name has in square brackets but a joint, be it a known unit or not, or its per cent; else empty."""
    words = {word for joint in joints for word in tokens(joint) if not word.isdecimal()}
    texts = [first or second for first, second in _STATED.findall(column)]
    return next((text for text in reversed(texts) if not set(tokens(text)) & words), "")


def _remove_words(words: tuple[str, ...], removed: tuple[str, ...]) -> tuple[str, ...]:
    remaining = list(words)
    for word in removed:
        # remove the last occurrence, since units stand at the end of a name
        if word in remaining:
            remaining.reverse()
            remaining.remove(word)
            remaining.reverse()
    return tuple(remaining)


def is_commanded(column: str) -> bool:
    """Return whether the name of a column says that it was commanded, as a reference is."""
    return bool(set(tokens(column)) & _COMMANDED_WORDS)


def is_reference(column: str, joints: Iterable[str]) -> bool:
    """Return whether the name of a column says that it is a reference position of a controller."""
    return is_commanded(column) and read_name(column, joints).role == "position"


def _measurement_rank(words: set[str]) -> int:
    measured = words & _MEASURED_WORDS
    # the measured current of a current control is none that was commanded
    if words & (_COMMANDED_WORDS - (_CONTROL_WORDS if measured else set()) | _DERIVED_WORDS):
        return COMMANDED
    return int(bool(measured)) - int(bool(words & _FILTERED_WORDS))
