"""Last check of a finished trajectory, by other means than those that made it: nothing that fails it is written.

All is sampled at 1 kHz or more, and forty times finer around the extremes. Derivatives are compared with differences.
Torques come from the regressor, and from Pinocchio where it is installed; distances come also from the real shapes
where these are known. Nothing is used that the design uses to keep within limits (bounds, working sets, reserves).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec

import numpy as np

from dynident.apps.excitation.limits import Feasibility, MotionLimits
from dynident.apps.excitation.trajectory import ClosestApproach, Trajectory, closest_approach
from dynident.models import Distances, Model, RigidBodies
from dynident.project.export import PinocchioArm, strip_to_joints
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

SAMPLE_RATE = 1000.0  # Hz
EXTREME_POINTS = 40  # points about an extreme, on either side
LIMIT_ROUNDING = 1e-6  # of a limit
REST_TOLERANCE = 1e-6  # of the velocity and acceleration limits: at rest
TORQUE_TOLERANCE = 1e-6  # of the largest torque: two routes to it agree
SECOND_ROUTE_SAMPLES = 1500  # samples for the second route, with those of the largest torques
BLOCK_SAMPLES = 4000
QUANTITIES = ("position", "velocity", "acceleration", "jerk", "torque")


def pinocchio_torque(model: Model, theta: Array, q: Array, dq: Array, ddq: Array) -> Array | None:
    """Return the torque (N, n) at parameters theta (p), with the bodies computed by Pinocchio's regressor.

    The other terms are computed by the model. None where Pinocchio is not installed or cannot read the
    joints, and where the bodies are not those of a URDF as it stands.
    """
    bodies = next((term for term in model.terms if isinstance(term, RigidBodies)), None)
    if bodies is None or bodies.format != "urdf" or bodies.displacements or find_spec("pinocchio") is None:
        return None
    # parameters of the bodies among all parameters of the model
    columns = model.parameter_slices[model.terms.index(bodies)]
    other_terms = tuple(term for term in model.terms if term is not bodies)
    try:
        arm = PinocchioArm.of(strip_to_joints(bodies.xml), bodies)
    except (ValueError, RuntimeError):  # of names and structures that it does not take
        return None
    if not all(arm.model.existJointName(body.joint.name) for body in bodies.arm.bodies):
        return None
    out = arm.torque((q, dq, ddq), _inverse_dynamics(arm, theta[columns].reshape(-1, 10)))
    if other_terms:
        out += replace(model, terms=other_terms, load=None).regressor(q, dq, ddq) @ np.delete(theta, columns)
    return out


def _inverse_dynamics(arm: PinocchioArm, theta: Array) -> Callable[[Array, Array, Array], Array]:
    """Return the torque of bodies with parameters (B, 10) by Pinocchio's regressor, as a function of the state."""
    import pinocchio as pin

    data, joint_ids = arm.model.createData(), arm.joint_ids
    all_parameters = np.zeros((arm.model.njoints, 10))
    # Pinocchio has an inertia for each joint, listed or not: bodies that are not fitted have none
    all_parameters[[joint_ids[k] for k in arm.bodies.arm.parameter_bodies]] = theta

    def torque(q: Array, dq: Array, ddq: Array) -> Array:
        regressor = np.reshape(pin.computeJointTorqueRegressor(arm.model, data, q, dq, ddq), (arm.model.nv, -1))
        return np.asarray(regressor @ all_parameters[1:].ravel())

    return torque


class LimitError(InputError):
    """A trajectory leaves its limits: joint, time, value and limit are in the words."""

    @classmethod
    def at(cls, joint: str, time: float, words: str) -> LimitError:
        """Return the error of a joint at a time (s)."""
        return cls(f"joint {joint!r} at {time:.4f} s: {words}; the trajectory is refused.")


class TrajectoryCheck(Noun):
    """Result of the check of a trajectory, at ``samples`` times.

    ``reached`` (5, n) are the shares used of the limits of position (from the middle of the range),
    velocity, acceleration, jerk and torque. ``routes`` names the ways in which the torque was computed.
    ``nearest`` is where the arm comes closest to itself or an obstacle, by the links as the design has them;
    ``nearest_shapes`` by their real shapes; None where that was not checked.
    """

    samples: int
    reached: Array
    routes: tuple[str, ...]
    nearest: ClosestApproach | None
    nearest_shapes: ClosestApproach | None


def verify(trajectory: Trajectory, feasible: Feasibility, shapes: Distances | None = None) -> TrajectoryCheck:
    """Check a trajectory, and return what it uses of the limits; of ``feasible`` only the numbers are used.

    ``shapes`` are the real shapes. Raises ``LimitError``, an InputError, that names joint, time, value and limit,
    where the trajectory does not begin or end at rest, jumps, or leaves a limit or the clearance (m).
    """
    model, theta, limits = feasible.model, feasible.theta, feasible.limits
    if trajectory.joints != limits.joints:
        raise InputError(f"the trajectory is of the joints {trajectory.joints}, the limits of {limits.joints}.")
    samples, reached = 0, np.zeros((5, len(limits.joints)))
    torque_samples: list[Array] = []
    last: Array | None = None
    for k in trajectory.first_indices:  # what is repeated is looked at once
        start, piece = trajectory.edges[k], trajectory.pieces[k]
        # at least three samples: the trapezoidal rule needs differences
        t = np.linspace(0.0, piece.course.duration, max(3, int(np.ceil(piece.course.duration * SAMPLE_RATE)) + 1))
        states = piece.course.states(t)
        _check_derivatives(states, t, float(start), limits)
        # a piece that repeats must also join itself
        _check_continuity(states[:, 0] if last is None else last, states[:, 0], float(start), limits)
        if trajectory.pieces[k + 1 : k + 2] and trajectory.pieces[k + 1].course is piece.course:
            _check_continuity(states[:, -1], states[:, 0], float(trajectory.edges[k + 1]), limits)
        values = _with_torque(model, theta, states)
        # extremes of a smooth course lie between samples: look closer around each of them
        fine_times = _times_near_extremes(t, values, limits)
        for times, sampled in ((t, values), (fine_times, _with_torque(model, theta, piece.course.states(fine_times)))):
            np.maximum(reached, _limit_shares(sampled, float(start) + times, limits), out=reached)
            # states spread evenly and those of the largest torques: all would take a long time by the second route
            largest, spread = np.abs(sampled[4]).argmax(axis=0), np.arange(0, len(times), max(1, len(times) // 100))
            torque_samples.append(sampled[:, np.union1d(largest, spread)])
            samples += len(times)
        last = states[:, -1]
    ends = trajectory.states(np.array([0.0, trajectory.duration]))
    _check_rest(ends, trajectory.duration, limits)
    routes = _second_route(model, theta, torque_samples)
    closest = [
        None if distances is None else _check_clearance(distances, trajectory, feasible.clearance)
        for distances in (feasible.space, shapes)
    ]
    return TrajectoryCheck(samples, reached, routes, *closest)


def _times_near_extremes(t: Array, values: Array, limits: MotionLimits) -> Array:
    """Return times (M) around the extremes of q, dq, ddq, jerk and torque (5, N, n)."""
    extremes = np.abs(values - _middles(limits)[:, None]).argmax(axis=1)
    # clipped to the course: beyond its ends there is no motion
    around = np.linspace(-1, 1, 2 * EXTREME_POINTS + 1) * (t[1] - t[0])
    return np.unique(np.clip(t[np.unique(extremes)][:, None] + around, 0.0, t[-1]))


def _middles(limits: MotionLimits) -> Array:
    """Return from where the quantities (5, n) are measured: position from the middle of its range, others from zero."""
    return np.stack([limits.middle, *np.zeros((4, len(limits.joints)))])


def _with_torque(model: Model, theta: Array, states: Array) -> Array:
    """Return q, dq, ddq, the jerk and the torque (5, N, n), which is the regressor times the parameters."""
    blocks = [states[:3, k : k + BLOCK_SAMPLES] for k in range(0, states.shape[1], BLOCK_SAMPLES)]
    torque = np.concatenate([model.regressor(*block) @ theta for block in blocks])
    return np.concatenate([states, torque[None]])


def _limit_shares(values: Array, t: Array, limits: MotionLimits) -> Array:
    """Return the largest shares of the limits (5, n); LimitError where one exceeds 1."""
    sizes, middles = np.stack([*limits.sizes, limits.torque]), _middles(limits)
    shares = np.abs(values - middles[:, None]) / sizes[:, None]
    if not (shares <= 1 + LIMIT_ROUNDING).all():
        which, row, joint = np.unravel_index(int(np.nan_to_num(shares, nan=np.inf).argmax()), shares.shape)
        value, middle = float(values[which, row, joint]), float(middles[which, joint])
        limit = middle + float(np.copysign(sizes[which, joint], value - middle))
        words = f"{QUANTITIES[which]} is {value:.6g}, beyond its limit {limit:.6g}"
        raise LimitError.at(limits.joints[joint], float(t[row]), words)
    return np.asarray(shares.max(axis=1))


def _check_continuity(before: Array, after: Array, t: float, limits: MotionLimits) -> None:
    """Raise LimitError where q, dq or ddq jump from one piece to the next."""
    jump = np.abs(after - before)[:3]
    allowed = REST_TOLERANCE * limits.sizes[:3]
    if not (jump <= allowed).all():
        which, joint = np.unravel_index(int(np.nan_to_num(jump / allowed, nan=np.inf).argmax()), jump.shape)
        raise LimitError.at(limits.joints[joint], t, f"{QUANTITIES[which]} jumps by {jump[which, joint]:.4g}")


def _check_derivatives(states: Array, t: Array, start: float, limits: MotionLimits) -> None:
    """Raise LimitError where q, dq or ddq are not the integrals of their derivatives: they jump, or these are wrong.

    Over a step h the error of the trapezoidal rule is at most h^3 / 12 times the largest second derivative
    of the integrand, and h^2 / 4 times its largest slope; ddq changes by at most h times the largest jerk.
    """
    not_finite = np.argwhere(~np.isfinite(states))
    if len(not_finite):
        which, row, joint = not_finite[0]
        words = f"{QUANTITIES[which]} is {states[which, row, joint]}"
        raise LimitError.at(limits.joints[joint], start + float(t[row]), words)
    h = float(t[1] - t[0])
    # bounds of the error of the trapezoidal rule by the jerk limit, plus rounding of the differences
    for d, error in enumerate((h**3 / 12, h**2 / 4, h)):
        integral = h * (states[d + 1, :-1] + states[d + 1, 1:]) / 2 if d < 2 else np.zeros_like(states[0, 1:])
        deviation = np.abs(np.diff(states[d], axis=0) - integral)
        allowed = error * limits.jerk * (1 + LIMIT_ROUNDING) + 1e-9 * (np.abs(states[d]).max() + limits.sizes[d])
        if not (deviation <= allowed).all():
            row, joint = np.unravel_index(int(np.nan_to_num(deviation / allowed, nan=np.inf).argmax()), deviation.shape)
            words = f"{QUANTITIES[d]} jumps by {deviation[row, joint]:.4g}"
            raise LimitError.at(limits.joints[joint], start + float(t[row]), words)


def _check_rest(ends: Array, duration: float, limits: MotionLimits) -> None:
    """Raise LimitError where the trajectory does not begin or end at rest; ``ends`` is (4, 2, n)."""
    for d in (1, 2):
        moving = np.abs(ends[d]) > REST_TOLERANCE * limits.sizes[d]
        if moving.any():
            end, joint = np.argwhere(moving)[0]
            words = f"{QUANTITIES[d]} is {ends[d, end, joint]:.4g} where the trajectory should be at rest"
            raise LimitError.at(limits.joints[joint], float(end) * duration, words)


def _second_route(model: Model, theta: Array, torque_samples: Sequence[Array]) -> tuple[str, ...]:
    """Return the routes to the torque; InputError where Pinocchio's differs from the regressor's."""
    *states, _, tau = np.concatenate(torque_samples, axis=1)
    # again the largest torques, and about SECOND_ROUTE_SAMPLES spread evenly
    rows = np.union1d(np.abs(tau).argmax(axis=0), np.arange(0, len(tau), -(-len(tau) // SECOND_ROUTE_SAMPLES)))
    pinocchio = pinocchio_torque(model, theta, *(state[rows] for state in states))
    if pinocchio is None:
        return ("regressor",)
    deviation, size = np.abs(pinocchio - tau[rows]).max(axis=0), np.abs(tau).max()
    if not (deviation <= TORQUE_TOLERANCE * size).all():
        joint = int(np.nan_to_num(deviation, nan=np.inf).argmax())
        raise InputError(
            f"joint {model.joints[joint].name!r}: the torque by Pinocchio differs by {deviation[joint]:.4g} "
            f"{model.joints[joint].effort} from that of the model; the trajectory is refused."
        )
    return ("regressor", "Pinocchio")


def _check_clearance(space: Distances, trajectory: Trajectory, clearance: float) -> ClosestApproach | None:
    """Return where the arm comes closest; LimitError where that is nearer than the clearance."""
    closest = closest_approach(space, trajectory.without_repeats, clearance)
    if closest is None:
        return None
    closest = replace(closest, time=trajectory.first_time(closest.time))
    if closest.distance < clearance - LIMIT_ROUNDING:
        first, second = closest.pair
        raise LimitError(
            f"{first!r} and {second!r} are {1000 * closest.distance:.2f} mm apart at {closest.time:.4f} s, nearer than "
            f"the clearance of {1000 * clearance:g} mm; the trajectory is refused."
        )
    return closest
