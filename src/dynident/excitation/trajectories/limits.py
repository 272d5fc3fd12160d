"""What a motion may reach: limits of the joints, less a margin.

Rules where neither the robot file nor the user gives a limit: a joint that turns has half a turn to either side of
zero, or a whole turn from the one end that is given (more than two turns in a file are no limit); its acceleration
takes it from rest to its greatest velocity in ``RISE``, its jerk to its greatest acceleration in ``ONSET``. A velocity,
or the range of a joint that slides, follows from no rule. Where there is no torque limit, no torque is too large.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, ModelError, brief, choices, listed
from dynident.models import Joint, RigidBodies
from dynident.models.robot_file import Limits

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["ONSET", "RISE", "JointLimits", "MotionLimits", "limits_of"]

Array = NDArray[np.float64]
RISE = 0.25  # s from rest to the velocity limit
ONSET = 0.05  # s from no acceleration to its limit
TWO_TURNS = 4.001 * np.pi  # rad: a file with a wider range has none
FROM_FILE = {"lower": "lower", "upper": "upper", "velocity": "velocity", "torque": "effort"}


@dataclass(frozen=True)
class JointLimits:
    """Limits that a user gives for one joint, None where the robot file or a rule says them: rad, rad/s, ... or m."""

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    torque: float | None = None


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of n joints, the margin taken off: ``lower`` and ``upper`` (rad, m), ``velocity``, ``acceleration``,
    ``jerk`` (per s, s^2, s^3) and ``torque`` (N m, N), each (n), infinite where there is none.

    ``by_rule`` names the quantities of each joint that neither the file nor the user gives, and a stated rule has made;
    ``beyond`` those that the user gives, and that exceed what the file allows.
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    torque: Array
    by_rule: Mapping[str, tuple[str, ...]]
    beyond: Mapping[str, tuple[str, ...]]

    __repr__ = brief

    @property
    def middle(self) -> Array:
        """The middles (n) of the ranges."""
        return (self.lower + self.upper) / 2

    @property
    def half(self) -> Array:
        """Half of the ranges (n)."""
        return (self.upper - self.lower) / 2

    @property
    def sizes(self) -> Array:
        """The largest sizes (4, n) of q less the ``middle``, of dq, ddq and jerk."""
        return np.stack([self.half, self.velocity, self.acceleration, self.jerk])


def limits_of(model: Model, given: Mapping[str, JointLimits] | None = None, margin: float = 0.1) -> MotionLimits:
    """Return the limits of a model's joints: as given, else of its file, else by rule; ``margin`` is the share of each
    range that is kept free, of a range of positions half at either end.

    Raises ConfigError for a margin out of range, an unknown joint and limits that contradict, ModelError for limits of
    the file that do, and where a limit is missing that no rule gives.
    """
    given = dict(given or {})
    names = [joint.name for joint in model.joints]
    for name in given:
        if name not in names:
            raise ConfigError(f"limits: no joint {name!r} moves in {model.name}; {choices(name, names)}")
    if not 0 <= margin < 1:
        raise ConfigError(f"limits: the margin is {margin:g}; the share of each range kept free is from 0 to below 1.")
    file = _narrowed(model)
    _check_complete(model, given, file)
    found = [_limits(joint, given.get(joint.name, JointLimits()), file[joint.name], model) for joint in model.joints]
    values = {one.name: np.array([getattr(joint, one.name) for joint, _ in found]) for one in fields(JointLimits)}
    spare = margin / 2 * (values["upper"] - values["lower"])
    values["lower"], values["upper"] = values["lower"] + spare, values["upper"] - spare
    for name in ("velocity", "acceleration", "jerk", "torque"):
        values[name] = (1 - margin) * values[name]
    made = {name: rules for name, (_, rules) in zip(names, found, strict=True) if rules}
    beyond = {name: over for name, own in given.items() if (over := _beyond(own, file[name]))}
    return MotionLimits(tuple(names), **values, by_rule=made, beyond=beyond)


def _narrowed(model: Model) -> dict[str, Limits]:
    """Return the limits of the file by joint, narrowed to those of the joints that mimic it."""
    found = {joint.name: _bounded(joint, model.limits.get(joint.name, Limits())) for joint in model.joints}
    for term in model.terms:
        arm = term.arm if isinstance(term, RigidBodies) else None
        for body, drive, rest in zip(arm.bodies, arm.drive, arm.rest, strict=True) if arm else ():
            column = int(np.argmax(np.abs(drive)))
            if column < len(model.joints) and drive[column] and body.joint.name not in found:
                name = model.joints[column].name
                found[name] = _meet(found[name], body.joint.limits, float(drive[column]), float(rest))
    return found


def _bounded(joint: Joint, file: Limits) -> Limits:
    """Return the limits of the file without a range that stands for an endless one."""
    if joint.kind == "prismatic" or None in (file.lower, file.upper):
        return file
    wide = (file.upper or 0.0) - (file.lower or 0.0) > TWO_TURNS
    return replace(file, lower=None, upper=None) if wide else file


def _meet(own: Limits, other: Limits, factor: float, offset: float) -> Limits:
    """Return the limits of a joint that another follows as ``factor`` q + ``offset``."""
    ends = [None if end is None else (end - offset) / factor for end in (other.lower, other.upper)]
    lower, upper = ends if factor > 0 else ends[::-1]
    speed = None if other.velocity is None else other.velocity / abs(factor)
    lowest = [end for end in (own.lower, lower) if end is not None]
    highest = [end for end in (own.upper, upper) if end is not None]
    slowest = [one for one in (own.velocity, speed) if one is not None]
    return Limits(own.effort, min(slowest, default=None), max(lowest, default=None), min(highest, default=None))


def _limits(joint: Joint, given: JointLimits, file: Limits, model: Model) -> tuple[JointLimits, tuple[str, ...]]:
    """Return all limits of a joint, and the names of those that are made by a rule."""
    values: dict[str, float | None] = {one.name: getattr(given, one.name) for one in fields(given)}
    _check_given(joint, values)
    own = {name for name, value in values.items() if value is not None}
    for name, theirs in FROM_FILE.items():
        values[name] = getattr(file, theirs) if values[name] is None else values[name]
    _check_range(joint, values, own, model)
    rules = []
    if values["lower"] is None or values["upper"] is None:
        values["lower"], values["upper"] = _range(values["lower"], values["upper"])
        rules.append("position")
    if (acceleration := values["acceleration"]) is None:
        values["acceleration"] = acceleration = (values["velocity"] or 0.0) / RISE
        rules.append("acceleration")
    if values["jerk"] is None:
        values["jerk"] = acceleration / ONSET
        rules.append("jerk")
    if values["torque"] is None:
        values["torque"] = np.inf
        rules.append("torque")
    return JointLimits(**values), tuple(rules)


def _check_given(joint: Joint, values: Mapping[str, float | None]) -> None:
    """Raise ConfigError where a value that the user gives is no number, or a size that is not positive."""
    for name, value in values.items():
        if value is None:
            continue
        if not np.isfinite(value):
            raise ConfigError(f"limits of joint {joint.name!r}: {name} is {value}; give a finite number.")
        if name not in ("lower", "upper") and value <= 0:
            raise ConfigError(f"limits of joint {joint.name!r}: {name} is {value:g}; give a number above 0.")


def _check_range(joint: Joint, values: Mapping[str, float | None], own: set[str], model: Model) -> None:
    """Raise ConfigError or ModelError where the limits of a joint contradict."""
    lower, upper = values["lower"], values["upper"]
    if lower is not None and upper is not None and lower >= upper:
        ends = [f"{name} {values[name]:g} ({'given' if name in own else 'file'})" for name in ("lower", "upper")]
        raise _fault(own & {"lower", "upper"})(
            f"limits of joint {joint.name!r}: {' and '.join(ends)} leave no position in {joint.unit}; "
            f"correct them{_where(own & {'lower', 'upper'}, model)}."
        )
    for name in ("velocity", "torque"):
        value = values[name]
        if value is not None and value <= 0:  # of the file
            raise ModelError(
                f"limits of joint {joint.name!r}: {name} is {value:g} in {model.name}, which no motion keeps; "
                f"give the true one in the settings, such as `limits: {{{joint.name!r}: {{{name}: 1.0}}}}`, or lock "
                "the joint."
            )


def _fault(own: set[str]) -> type[ConfigError] | type[ModelError]:
    return ConfigError if own else ModelError


def _where(own: set[str], model: Model) -> str:
    return "" if own else f" in {model.name}, or give both"


def _range(lower: float | None, upper: float | None) -> tuple[float, float]:
    """Return the range of a joint that turns of which an end or both are missing."""
    if lower is None and upper is None:
        return -np.pi, np.pi
    return (lower, lower + 2 * np.pi) if lower is not None else ((upper or 0.0) - 2 * np.pi, upper or 0.0)


def _check_complete(model: Model, given: Mapping[str, JointLimits], file: Mapping[str, Limits]) -> None:
    """Raise ModelError with the joints whose velocity, or whose way where they slide, nobody limits."""
    missing: dict[str, list[str]] = {}
    for joint in model.joints:
        own, theirs = given.get(joint.name, JointLimits()), file[joint.name]
        if own.velocity is None and theirs.velocity is None:
            missing.setdefault(f"velocity (in {joint.unit}/s)", []).append(joint.name)
        for end in ("lower", "upper") if joint.kind == "prismatic" else ():
            if getattr(own, end) is None and getattr(theirs, end) is None:
                missing.setdefault(f"{end} (in m)", []).append(joint.name)
    if missing:
        lacking = "; ".join(f"{what} of {listed(names)}" for what, names in missing.items())
        what, names = next(iter(missing.items()))
        raise ModelError(
            f"limits: {model.name} does not say, and no rule can: {lacking}. Give each in the settings, such as "
            f"`limits: {{{names[0]!r}: {{{what.partition(' ')[0]}: 1.0}}}}`."
        )


def _beyond(own: JointLimits, file: Limits) -> tuple[str, ...]:
    """Return the names of the limits that a user gives beyond those of the file."""
    pairs = {name: (getattr(own, name), getattr(file, theirs)) for name, theirs in FROM_FILE.items()}
    known = {name: pair for name, pair in pairs.items() if None not in pair}
    return tuple(name for name, (one, other) in known.items() if (one < other if name == "lower" else one > other))
