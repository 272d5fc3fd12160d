"""Limits of the joints for a motion, less a margin.

Rules where neither the robot file nor the user gives a limit: a joint that turns has half a turn to
either side of zero, or a whole turn from the one end that is given (more than two turns in a file are no
limit). Its acceleration takes it from rest to its greatest velocity in ``ACCELERATION_TIME``, its jerk
to its greatest acceleration in ``JERK_TIME``. No rule gives a velocity, or the range of a joint that
slides. Where there is no torque limit, no torque is too large.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from dynident.apps.excitation.trajectory import Course
from dynident.models import EmptySpace, Joint, Model, RigidBodies, Space
from dynident.models.robot_files import RobotJointLimits
from dynident.project.arms import KnownArm, find_arm
from dynident.project.fields import Number, Positive, Section
from dynident.runtime import ConfigError, ModelError, Noun, choices, join_names
from dynident.runtime.arrays import Array

ACCELERATION_TIME = 0.25  # s from rest to the velocity limit
JERK_TIME = 0.05  # s from no acceleration to its limit
MAX_FILE_RANGE = 4.001 * np.pi  # rad: a file with a wider range has none
LimitValues = dict[str, float | None]  # of a joint by the fields of ``JointLimits``
RULES: Mapping[str, Callable[[Mapping[str, Any]], float]] = {  # each by the limits before; the range is a whole turn
    "lower": lambda limits: -np.pi if limits["upper"] is None else limits["upper"] - 2 * np.pi,
    "upper": lambda limits: limits["lower"] + 2 * np.pi,
    "acceleration": lambda limits: limits["velocity"] / ACCELERATION_TIME,
    "jerk": lambda limits: limits["acceleration"] / JERK_TIME,
    "torque": lambda _: np.inf,
}
LIMITS_FILE = "limits.yaml"  # of a motion, with usual limits in place of rules
MIN_SPEED_SHARE = 0.03  # of the velocity limit

SAMPLE_RATE, MIN_SAMPLES = 100.0, 25  # Hz, samples of a course
TORQUE_RESERVE = 0.02  # of a torque limit, for what lies between samples
DISTANCE_RESERVE = 1e-3  # m of distance, likewise
CREEP_SHARE = 0.01  # of the velocity limit: slow
BATCH_POSES, MAX_BATCHES = 500, 10  # random poses


class JointLimits(Section):
    """Limits that a user gives for one joint, in rad or m, per s, s^2 and s^3, and N m or N; those left out are the
    robot file's, or made by a rule."""

    lower: Number | None = None
    upper: Number | None = None
    velocity: Positive | None = None
    acceleration: Positive | None = None
    jerk: Positive | None = None
    torque: Positive | None = None

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError(f"`lower` must be below `upper`, but {self.lower:g} >= {self.upper:g}")
        return self


class MotionLimits(Noun):
    """Limits of n joints less the margin, each (n), infinite where there is none.

    These are ``lower`` and ``upper`` (rad, m), ``velocity``, ``acceleration``, ``jerk`` (per s, s^2, s^3) and
    ``torque`` (N m, N). ``by_rule`` names the quantities of each joint that neither the file nor the user gives, so
    that a stated rule does; ``beyond`` those that the user gives, and that exceed the limit of the file.
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

    @property
    def middle(self) -> Array:
        """Middle of the ranges (n)."""
        return (self.lower + self.upper) / 2

    @property
    def half(self) -> Array:
        """Half of the ranges (n)."""
        return (self.upper - self.lower) / 2

    @property
    def sizes(self) -> Array:
        """Largest amounts (4, n) of q less the ``middle``, of dq, ddq and jerk."""
        return np.stack([self.half, self.velocity, self.acceleration, self.jerk])


def motion_limits(
    model: Model, user_limits: Mapping[str, JointLimits] | None = None, margin: float = 0.1
) -> MotionLimits:
    """Return the limits of a model's joints: as the user gives them, else of its file, else by rule.

    ``margin`` is the share of each range that is kept free, of a range of positions half at either end.
    Raises ConfigError for an unknown joint and limits that contradict each other, and ModelError for limits of
    the file that do, and where a limit is missing that no rule gives.
    """
    given = {name: limits.model_dump() for name, limits in (user_limits or {}).items()}
    names = [joint.name for joint in model.joints]
    for name in given:
        if name not in names:
            raise ConfigError(f"limits: no joint {name!r} moves in {model.name}; {choices(name, names)}")
    of_file = _file_limits(model)
    # given by the user, else by the file, else by a rule
    limits = {name: dict(of_file[name]) for name in names}
    for name, values in given.items():
        limits[name] |= {kind: value for kind, value in values.items() if value is not None}
    # checked for all joints before any rule is applied, so that one message names everything that is missing
    _check_complete(model, limits)
    for joint in model.joints:
        _check_range(joint, limits[joint.name], given.get(joint.name, {}), model)
    by_rule = {name: rules for name in names if (rules := _apply_rules(limits[name]))}
    values = {kind: np.array([limits[name][kind] for name in names], dtype=float) for kind in JointLimits.model_fields}
    # half of the margin at either end
    reserve = margin / 2 * (values["upper"] - values["lower"])
    values["lower"], values["upper"] = values["lower"] + reserve, values["upper"] - reserve
    for kind in ("velocity", "acceleration", "jerk", "torque"):
        values[kind] = (1 - margin) * values[kind]
    beyond = {name: kinds for name in given if (kinds := _exceeded_limits(given[name], of_file[name]))}
    return MotionLimits(tuple(names), **values, by_rule=by_rule, beyond=beyond)


def usual_arm(model: Model, limits: MotionLimits) -> KnownArm | None:
    """Return the well-known arm of a model; None where it is none, or no rule stands for one of its limits."""
    arm = find_arm({joint.name: model.limits.get(joint.name, RobotJointLimits()) for joint in model.joints})
    ruled = {(joint, kind) for joint, kinds in limits.by_rule.items() for kind in kinds}
    arm_limits = {(joint, kind) for joint, kinds in arm.limits.items() for kind in kinds} if arm else set()
    return arm if ruled & arm_limits else None


def _file_limits(model: Model) -> dict[str, LimitValues]:
    """Return the limits of the file by joint, narrowed to those of the joints that mimic it."""
    limits = {joint.name: _limit_values(model.limits.get(joint.name, RobotJointLimits())) for joint in model.joints}
    for joint in model.joints:
        lower, upper = limits[joint.name]["lower"], limits[joint.name]["upper"]
        # a range that stands for an endless one
        if joint.kind != "prismatic" and lower is not None and upper is not None and upper - lower > MAX_FILE_RANGE:
            limits[joint.name] |= {"lower": None, "upper": None}
    for term in model.terms:
        arm = term.arm if isinstance(term, RigidBodies) else None
        for body, drive, offset in zip(arm.bodies, arm.drive, arm.offset, strict=True) if arm else ():
            # the model's joint that drives the body, if it is not the body's own
            column = int(np.argmax(np.abs(drive)))
            if column < len(model.joints) and drive[column] and body.joint.name not in limits:
                follower = _limit_values(body.joint.limits)
                _narrow_limits(limits[model.joints[column].name], follower, float(drive[column]), float(offset))
    return limits


def _limit_values(limits: RobotJointLimits) -> LimitValues:
    """Return the limits of a file by the names that a user has for them; acceleration and jerk are never there."""
    file_values = {"lower": limits.lower, "upper": limits.upper, "velocity": limits.velocity, "torque": limits.effort}
    return dict.fromkeys(JointLimits.model_fields) | file_values


def _narrow_limits(limits: LimitValues, follower: LimitValues, factor: float, offset: float) -> None:
    """Narrow the limits of a joint to those of another, which follows it as ``factor`` q + ``offset``."""
    # q = (q' - offset) / factor; a negative factor swaps the ends
    ends = [None if (end := follower[kind]) is None else (end - offset) / factor for kind in ("lower", "upper")]
    lower, upper = ends if factor > 0 else ends[::-1]
    velocity = None if follower["velocity"] is None else follower["velocity"] / abs(factor)
    for kind, bound, tighter in (("lower", lower, max), ("upper", upper, min), ("velocity", velocity, min)):
        limits[kind] = tighter((x for x in (limits[kind], bound) if x is not None), default=None)


def _apply_rules(limits: LimitValues) -> tuple[str, ...]:
    """Fill in the limits of a joint that are missing by rules, and return their names."""
    rules = []
    for kind, rule in RULES.items():
        if limits[kind] is None:
            limits[kind] = rule(limits)
            rules.append("position" if kind in ("lower", "upper") else kind)
    return tuple(dict.fromkeys(rules))


def _check_range(joint: Joint, limits: LimitValues, given: LimitValues, model: Model) -> None:
    """Raise ConfigError or ModelError where the limits of a joint contradict each other."""
    lower, upper = limits["lower"], limits["upper"]
    if lower is not None and upper is not None and lower >= upper:
        is_given = {kind: given.get(kind) is not None for kind in ("lower", "upper")}
        ends = [f"{kind} {limits[kind]:g} ({'given' if is_given[kind] else 'file'})" for kind in is_given]
        place = "" if any(is_given.values()) else f" in {model.name}, or give both"
        words = f"{' and '.join(ends)} leave no position in {joint.unit}; correct them{place}."
        raise (ConfigError if any(is_given.values()) else ModelError)(f"limits of joint {joint.name!r}: {words}")
    for kind in ("velocity", "torque"):
        value = limits[kind]
        if value is not None and value <= 0:  # of the file
            raise ModelError(
                f"limits of joint {joint.name!r}: {kind} is {value:g} in {model.name}, which no motion keeps; "
                f"give the true one in the settings, such as `limits: {{{joint.name!r}: {{{kind}: 1.0}}}}`, or lock "
                "the joint."
            )


def _check_complete(model: Model, limits: Mapping[str, LimitValues]) -> None:
    """Raise ModelError with the joints that have no velocity limit, or no range where they slide."""
    missing: dict[str, list[str]] = {}
    for joint in model.joints:
        needed = {"velocity": f"{joint.unit}/s"}
        needed |= {"lower": "m", "upper": "m"} if joint.kind == "prismatic" else {}
        for kind, unit in needed.items():
            if limits[joint.name][kind] is None:
                missing.setdefault(f"{kind} (in {unit})", []).append(joint.name)
    if missing:
        missing_words = "; ".join(f"{quantity} of {join_names(names)}" for quantity, names in missing.items())
        quantity, names = next(iter(missing.items()))
        raise ModelError(
            f"limits: {model.name} does not say, and no rule can: {missing_words}. Give each in the settings, such as "
            f"`limits: {{{names[0]!r}: {{{quantity.partition(' ')[0]}: 1.0}}}}`."
        )


def _exceeded_limits(given: LimitValues, of_file: LimitValues) -> tuple[str, ...]:
    """Return the names of the limits that a user gives beyond those of the file."""
    exceeded = []
    for kind, value in given.items():
        bound = of_file[kind]
        if value is not None and bound is not None and (value < bound if kind == "lower" else value > bound):
            exceeded.append(kind)
    return tuple(exceeded)


def min_fit_speeds(model: Model, limits: MotionLimits) -> Array:
    """Return the speed (n) below which a fit leaves out a joint's torque.

    It is 3 % of the velocity limit for joints with dry friction, which may hold the joint with any torque up
    to its own, and after which it moves on with a jerk; zero for others.
    """
    state = np.zeros((1, len(limits.joints))), limits.velocity[None], np.zeros((1, len(limits.joints)))
    has_friction = np.zeros(len(limits.joints), dtype=bool)
    # a term rubs where it acts on a joint that moves at its velocity limit
    for term in (candidate for candidate in model.terms if candidate.has_own("discontinuous")):
        load = (np.ones((1, term.memory)),) if term.memory else ()  # any but zero
        has_friction |= term.regressor(*state, *load).any(axis=(0, 2))
    return np.where(has_friction & np.isfinite(limits.velocity), MIN_SPEED_SHARE * limits.velocity, 0.0)


class Feasibility(Noun):
    """Limits of a model with parameters ``theta`` (p): ``limits`` of its joints, and ``clearance`` (m) in ``space``.

    Without ``space`` nothing is in the way. Pieces take whole multiples of ``step`` (s), 0 for any duration.
    """

    model: Model
    theta: Array
    limits: MotionLimits
    space: Space = EmptySpace()
    clearance: float = 0.0
    step: float = 0.0

    def max_torque_share(self, course: Course) -> float:
        """Return the largest torque of a course as a share of its limit."""
        q, dq, ddq, _ = course.states(_sample_times(course))
        return float(self.torque_shares(q, dq, ddq).max(initial=0.0))

    def torque_shares(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the absolute torque as shares of the limits, shape (N, n)."""
        shares: Array = np.abs(self.model.torque(q, dq, ddq, self.theta)) / self.limits.torque
        return shares

    def min_gaps(self, q: Array) -> Array:
        """Return the smallest distances (N), m, less the clearance, at positions q (N, n)."""
        nearest: Array = self.space.distances(q).min(axis=1, initial=np.inf)
        return nearest - self.clearance

    def is_clear(self, course: Course) -> bool:
        """Return whether a course keeps its distance."""
        return bool(self.min_gaps(course.states(_sample_times(course))[0]).min() >= DISTANCE_RESERVE)

    def allows(self, course: Course) -> bool:
        """Return whether a course keeps to torque and distance; its position and derivatives are not checked."""
        return self.max_torque_share(course) <= 1 - TORQUE_RESERVE and self.is_clear(course)

    def is_free(self, q: Array) -> NDArray[np.bool_]:
        """Return in which poses (N, n) the arm is clear, and can be held and moved slowly by its torque, shape (N)."""
        return np.asarray(
            (self._creep_shares(q) <= 1 - TORQUE_RESERVE).all(axis=1) & (self.min_gaps(q) >= DISTANCE_RESERVE)
        )

    def can_stand(self, q: Array) -> NDArray[np.bool_]:
        """Return in which poses (N, n) the arm can stand: within its range and free, shape (N)."""
        inside = ((q >= self.limits.lower) & (q <= self.limits.upper)).all(axis=1)
        return np.asarray(inside & self.is_free(q))

    def _creep_shares(self, q: Array) -> Array:
        """Return the torque of poses as shares (N, n) of the limits, for joints that creep in either direction."""
        # near rest, Coulomb friction acts against the motion: try both signs of a small velocity
        zeros, creep = np.zeros_like(q), np.broadcast_to(CREEP_SHARE * self.limits.velocity, q.shape)
        return np.maximum(self.torque_shares(q, creep, zeros), self.torque_shares(q, -creep, zeros))

    def random_poses(self, count: int, rng: np.random.Generator) -> Array:
        """Return at most ``count`` random poses (K, n) in which the arm can stand.

        Raises ConfigError where none is found, with what is in the way.
        """
        batches, feasible_batches = list[Array](), list[Array]()
        for _ in range(MAX_BATCHES):
            drawn = rng.uniform(self.limits.lower, self.limits.upper, (BATCH_POSES, len(self.limits.joints)))
            batches.append(drawn)
            feasible_batches.append(drawn[self.can_stand(drawn)])
            if sum(map(len, feasible_batches)) >= count:
                break
        poses = np.concatenate(feasible_batches)[:count]
        if not len(poses):
            raise ConfigError(self._explain_blocked(np.concatenate(batches)))
        return poses

    def _explain_blocked(self, q: Array) -> str:
        """Explain why the arm stands in none of the poses (N, n)."""
        shares = self._creep_shares(q)
        # the joint that fails in most poses is the one to name
        joint = int(np.argmax((shares > 1 - TORQUE_RESERVE).sum(axis=0)))
        heavy_count = int((shares > 1 - TORQUE_RESERVE).any(axis=1).sum())
        too_near = self.min_gaps(q) < DISTANCE_RESERVE
        sentences = [f"of {len(q)} random poses the arm can stand in none."]
        if heavy_count:
            name, limit = self.limits.joints[joint], self.limits.torque[joint]
            # what the joint takes without friction tells which of both is the cause
            at_rest, zeros = np.abs(self.model.torque(q, 0 * q, 0 * q, self.theta))[:, joint], np.zeros(len(q))
            friction = float(np.median(np.maximum(zeros, shares[:, joint] * limit - at_rest)))
            cause = "gravity" if (at_rest > (1 - TORQUE_RESERVE) * limit).mean() > 0.5 else "gravity with friction"
            if friction > (1 - TORQUE_RESERVE) * limit:
                cause = f"dry friction alone ({friction:.4g})"
            sentences.append(
                f"In {heavy_count} {cause} needs more torque than is allowed, mostly of joint {name!r} ({limit:.4g})."
            )
        if too_near.any():
            pairs = self.space.pairs
            first, second = pairs[int(np.bincount(self.space.distances(q[too_near]).argmin(axis=1)).argmax())]
            sentences.append(
                f"In {int(too_near.sum())} something is nearer than {1000 * self.clearance:.3g} mm, mostly {first!r} "
                f"and {second!r}."
            )
        return " ".join([*sentences, "Check the limits, the margin, and what is in the way."])


def _sample_times(course: Course) -> Array:
    return np.linspace(0.0, course.duration, max(MIN_SAMPLES, int(course.duration * SAMPLE_RATE) + 1))
