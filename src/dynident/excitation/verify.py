"""The last check of a finished trajectory, by other means than those that made it: nothing that fails it is written.

All is sampled at 1 kHz or more, and forty times finer about the extremes. Derivatives are compared with differences,
torques come from the regressor, and from Pinocchio where it is installed, distances also from the real shapes where
they can be had. Nothing that the design uses to keep within limits (bounds, working sets, reserves) is used here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.excitation.other_torque import pinocchio_torque
from dynident.excitation.spaces.space import Distances
from dynident.excitation.trajectories.limits import MotionLimits
from dynident.excitation.trajectories.nearest import Nearest, nearest
from dynident.excitation.trajectories.trajectory import Trajectory

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["LimitError", "Verified", "verify"]

Array = NDArray[np.float64]
RATE = 1000.0  # Hz
FINER = 40  # points about an extreme, on either side
ROUNDING = 1e-6  # of a limit
REST = 1e-6  # of the velocity and acceleration limits: at rest
AGREE = 1e-6  # of the largest torque: two routes to it agree
SECOND = 1500  # samples for the second route, with those of the largest torques
BLOCK = 4000
QUANTITIES = ("position", "velocity", "acceleration", "jerk", "torque")


class LimitError(InputError):
    """A trajectory that leaves its limits: ``quantity`` of ``joint`` (or pair of links) has ``value`` at ``time`` (s),
    and ``limit`` is what is allowed."""

    def __init__(self, quantity: str, joint: str, time: float, value: float, limit: float, what: str) -> None:
        super().__init__(what)
        self.quantity, self.joint, self.time, self.value, self.limit = quantity, joint, time, value, limit

    def __reduce__(self) -> tuple[type, tuple[str, str, float, float, float, str]]:
        return type(self), (self.quantity, self.joint, self.time, self.value, self.limit, str(self))


@dataclass(frozen=True, eq=False)
class Verified:
    """What the check of a trajectory has found, at ``samples`` times.

    ``reached`` (5, n) is what is used of the limits of position (from the middle of the range), velocity, acceleration,
    jerk and torque, as shares. ``routes`` names what the torque was computed by. ``nearest`` is where the arm comes
    closest to itself or an obstacle, by the links as the design has them; ``nearest_shapes`` by their real shapes; None
    where that was not looked at.
    """

    samples: int
    reached: Array
    routes: tuple[str, ...]
    nearest: Nearest | None
    nearest_shapes: Nearest | None

    __repr__ = brief


def verify(
    trajectory: Trajectory,
    model: Model,
    theta: Array,
    limits: MotionLimits,
    space: Distances | None = None,
    clearance: float = 0.0,
    *,
    shapes: Distances | None = None,
) -> Verified:
    """Return what a trajectory uses of its limits; ``theta`` (p) gives the torque, ``shapes`` are the real ones.

    Raises ``LimitError``, an InputError, with joint, time, value and limit, where it does not begin or end at rest,
    jumps, or leaves a limit or the clearance (m).
    """
    if trajectory.joints != limits.joints:
        raise InputError(f"the trajectory is of the joints {trajectory.joints}, the limits of {limits.joints}.")
    samples, reached = 0, np.zeros((5, len(limits.joints)))
    kept: list[tuple[Array, Array]] = []
    last: Array | None = None
    for k in trajectory.firsts:  # what is repeated is looked at once
        start, piece = trajectory.edges[k], trajectory.pieces[k]
        t = np.linspace(0.0, piece.course.duration, max(3, int(np.ceil(piece.course.duration * RATE)) + 1))
        states = piece.course.states(t)
        _check_derivatives(states, t, float(start), limits)
        _check_joined(states[:, 0] if last is None else last, states[:, 0], float(start), limits)
        if trajectory.pieces[k + 1 : k + 2] and trajectory.pieces[k + 1].course is piece.course:
            _check_joined(states[:, -1], states[:, 0], float(trajectory.edges[k + 1]), limits)
        tau = _torque(model, theta, states)
        fine = _finer(t, states, tau, limits)
        finer = piece.course.states(fine)
        for times, found, load in ((t, states, tau), (fine, finer, _torque(model, theta, finer))):
            np.maximum(reached, _shares(found, load, float(start) + times, limits), out=reached)
            kept.append(_some(found, load))
            samples += len(times)
        last = states[:, -1]
    ends = trajectory.states(np.array([0.0, trajectory.duration]))
    _check_rest(ends, trajectory.duration, limits)
    routes = _second_route(model, theta, kept)
    near = [None if one is None else _near(one, trajectory, clearance) for one in (space, shapes)]
    return Verified(samples, reached, routes, *near)


def _finer(t: Array, states: Array, tau: Array, limits: MotionLimits) -> Array:
    """Return times (M) about the extremes of q, dq, ddq, jerk and torque."""
    middles = np.stack([limits.middle, *np.zeros((4, len(limits.joints)))])
    extremes = np.abs(np.concatenate([states, tau[None]]) - middles[:, None]).argmax(axis=1)
    around = np.linspace(-1, 1, 2 * FINER + 1) * (t[1] - t[0])
    return np.unique(np.clip(t[np.unique(extremes)][:, None] + around, 0.0, t[-1]))


def _torque(model: Model, theta: Array, states: Array) -> Array:
    """Return the torque (N, n) as the regressor times the parameters."""
    blocks = [states[:3, k : k + BLOCK] for k in range(0, states.shape[1], BLOCK)]
    return np.concatenate([model.regressor(*block) @ theta for block in blocks])


def _shares(states: Array, tau: Array, t: Array, limits: MotionLimits) -> Array:
    """Return the largest shares of the limits (5, n); LimitError where one is above 1."""
    q, dq, ddq, jerk = states
    values = np.stack([q, dq, ddq, jerk, tau])
    sizes = np.stack([limits.half, *limits.sizes[1:], limits.torque])
    middles = np.stack([limits.middle, *np.zeros((4, len(limits.joints)))])
    shares = np.abs(values - middles[:, None]) / sizes[:, None]
    if not (shares <= 1 + ROUNDING).all():
        which, row, joint = np.unravel_index(int(np.nan_to_num(shares, nan=np.inf).argmax()), shares.shape)
        value, middle = float(values[which, row, joint]), float(middles[which, joint])
        limit = middle + float(np.copysign(sizes[which, joint], value - middle))
        raise _exceeded(QUANTITIES[which], limits.joints[joint], float(t[row]), value, limit)
    return np.asarray(shares.max(axis=1))


def _exceeded(quantity: str, joint: str, time: float, value: float, limit: float) -> LimitError:
    what = (
        f"joint {joint!r} at {time:.4f} s: {quantity} is {value:.6g}, beyond its limit {limit:.6g}; "
        "the trajectory is refused."
    )
    return LimitError(quantity, joint, time, value, limit, what)


def _check_joined(before: Array, after: Array, t: float, limits: MotionLimits) -> None:
    """Raise LimitError where q, dq or ddq jump from one piece to the next."""
    jump = np.abs(after - before)[:3]
    allowed = REST * limits.sizes[:3]
    if not (jump <= allowed).all():
        which, joint = np.unravel_index(int(np.nan_to_num(jump / allowed, nan=np.inf).argmax()), jump.shape)
        raise _jumps(QUANTITIES[which], limits.joints[joint], t, float(jump[which, joint]))


def _jumps(quantity: str, joint: str, t: float, by: float) -> LimitError:
    what = f"joint {joint!r} at {t:.4f} s: {quantity} jumps by {by:.4g}; the trajectory is refused."
    return LimitError(quantity, joint, t, by, 0.0, what)


def _check_derivatives(states: Array, t: Array, start: float, limits: MotionLimits) -> None:
    """Raise LimitError where q, dq or ddq are not what their derivatives add up to: they jump, or these are wrong.

    Over a step h the trapezoidal rule is wrong by at most h^3 / 12 times the largest second derivative of what it adds
    up, and h^2 / 4 times its largest slope; ddq changes by at most h times the largest jerk.
    """
    wrong = np.argwhere(~np.isfinite(states))
    if len(wrong):
        which, row, joint = wrong[0]
        name, time, value = limits.joints[joint], start + float(t[row]), float(states[which, row, joint])
        what = f"joint {name!r} at {time:.4f} s: {QUANTITIES[which]} is {value}; the trajectory is refused."
        raise LimitError(QUANTITIES[which], name, time, value, float("nan"), what)
    h = float(t[1] - t[0])
    for d, error in enumerate((h**3 / 12, h**2 / 4, h)):
        added = h * (states[d + 1, :-1] + states[d + 1, 1:]) / 2 if d < 2 else np.zeros_like(states[0, 1:])
        off = np.abs(np.diff(states[d], axis=0) - added)
        allowed = error * limits.jerk * (1 + ROUNDING) + 1e-9 * (np.abs(states[d]).max() + limits.sizes[d])
        if not (off <= allowed).all():
            row, joint = np.unravel_index(int(np.nan_to_num(off / allowed, nan=np.inf).argmax()), off.shape)
            raise _jumps(QUANTITIES[d], limits.joints[joint], start + float(t[row]), float(off[row, joint]))


def _check_rest(ends: Array, duration: float, limits: MotionLimits) -> None:
    """Raise LimitError where the trajectory does not begin or end at rest; ``ends`` is (4, 2, n)."""
    for d in (1, 2):
        moving = np.abs(ends[d]) > REST * limits.sizes[d]
        if moving.any():
            end, joint = np.argwhere(moving)[0]
            value, name, t = float(ends[d, end, joint]), limits.joints[joint], float(end) * duration
            what = (
                f"joint {name!r} at {t:.4f} s: {QUANTITIES[d]} is {value:.4g} where the trajectory should be at rest."
            )
            raise LimitError(QUANTITIES[d], name, t, value, 0.0, what)


def _some(states: Array, tau: Array) -> tuple[Array, Array]:
    """Return some of the states (3, K, n) with their torques: spread evenly, and those of the largest torques."""
    rows = np.union1d(np.abs(tau).argmax(axis=0), np.arange(0, len(tau), max(1, len(tau) // 100)))
    return states[:3, rows], tau[rows]


def _second_route(model: Model, theta: Array, kept: Sequence[tuple[Array, Array]]) -> tuple[str, ...]:
    """Return the routes to the torque; InputError where Pinocchio's differs from the regressor's."""
    states, tau = np.concatenate([one for one, _ in kept], axis=1), np.concatenate([one for _, one in kept])
    rows = np.union1d(np.abs(tau).argmax(axis=0), np.arange(0, len(tau), -(-len(tau) // SECOND)))
    other = pinocchio_torque(model, theta, *states[:, rows])
    if other is None:
        return ("regressor",)
    off, size = np.abs(other - tau[rows]).max(axis=0), np.abs(tau).max()
    if not (off <= AGREE * size).all():
        joint = int(np.nan_to_num(off, nan=np.inf).argmax())
        raise InputError(
            f"joint {model.joints[joint].name!r}: the torque by Pinocchio differs by {off[joint]:.4g} "
            f"{model.joints[joint].effort} from that of the model; the trajectory is refused."
        )
    return ("regressor", "Pinocchio")


def _near(space: Distances, trajectory: Trajectory, clearance: float) -> Nearest | None:
    """Return where the arm comes closest; LimitError where that is nearer than the clearance."""
    found = nearest(space, trajectory.once, clearance)
    if found is None:
        return None
    found = replace(found, time=trajectory.first_time(found.time))
    if found.distance < clearance - ROUNDING:
        one, other = found.pair
        what = (
            f"{one!r} and {other!r} are {1000 * found.distance:.2f} mm apart at {found.time:.4f} s, nearer than the "
            f"clearance of {1000 * clearance:g} mm; the trajectory is refused."
        )
        raise LimitError("distance", f"{one} and {other}", found.time, found.distance, clearance, what)
    return found
