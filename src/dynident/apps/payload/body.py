"""The ten parameters of a payload as a body: physical consistency, and mass, centre and tensor with errors."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from dynident.estimators import BodyConstraint, Constraints
from dynident.estimators.cone import minimise
from dynident.models import INERTIAL, Model, RigidBodies, change_frame, to_physical
from dynident.models.robot_files import ArmBody
from dynident.runtime import ModelError, Note, Noun, Severity, choices, number, number_within, percent, short
from dynident.runtime.arrays import Array

MAX_MASS = 1e3  # kg: weak prior of the mass
TYPICAL_LENGTH, MIN_MASS = 0.1, 0.05  # m, kg: the size of a payload, for the scale of its pseudo-inertia
MIN_EIGENVALUE = 1e-6  # least eigenvalue of the scaled pseudo-inertia
RELATIVE_STEP = 1e-6
FLANGES = ("flange", "tool0", "tcp")  # of ROS-Industrial (REP 199) and of many robot files, the first that there is

MOTION_DURATION, SAMPLES_PER_PERIOD = 10.0, 60  # s of a motion, and samples of a period of it that are looked at
N_POSES = 4  # postures of the arm in which a joint turns
MAX_REACH, MAX_SPEED, SPEED_LIMIT_SHARE = 0.8, 1.5, 0.7  # rad (m); rad/s (m/s); of the limits
SLIDE_FACTOR = 0.3  # a sliding joint moves less far, in m
MAX_HELPFUL_STD = 0.7  # of the standard error: what is left by a motion that is worth naming


class Component(StrEnum):
    """A component of a body: mass, centre of mass, inertia about it."""

    MASS = "mass"
    X = "x"
    Y = "y"
    Z = "z"
    IXX = "Ixx"
    IXY = "Ixy"
    IYY = "Iyy"
    IXZ = "Ixz"
    IYZ = "Iyz"
    IZZ = "Izz"

    @property
    def unit(self) -> str:
        """Its unit in SI."""
        if self is Component.MASS:
            return "kg"
        return "m" if self in (Component.X, Component.Y, Component.Z) else "kg m^2"

    @property
    def meaning(self) -> str:
        """What it is, in words."""
        names = {"kg": "mass", "m": f"centre of mass, {self}"}
        return names.get(self.unit, f"inertia about the centre of mass, {self[1:]}")


class PhysicalBody(Noun):
    """Mass (kg), centre of mass (3) in m, and inertia (6) in kg m^2 about it: Ixx, Ixy, Iyy, Ixz, Iyz, Izz, all in one
    frame's axes; ``values`` (10), their ``std`` (10)."""

    values: Array
    std: Array

    @property
    def mass(self) -> float:
        """The mass in kg."""
        return float(self.values[0])

    @property
    def centre(self) -> Array:
        """The centre of mass (3) in m."""
        return np.asarray(self.values[1:4])

    @property
    def tensor(self) -> Array:
        """The inertia (3, 3) in kg m^2 about the centre of mass."""
        xx, xy, yy, xz, yz, zz = self.values[4:]
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def make_consistent(phi: Array, information: Array) -> Array:
    """Return the physically consistent parameters (10) nearest to phi (10) by their ``information`` (10, 10).

    A payload of no mass is consistent. Raises ModelError where the conic solver fails.
    """
    size = np.sqrt(max(float(phi[0]), MIN_MASS)) * np.array([TYPICAL_LENGTH, TYPICAL_LENGTH, TYPICAL_LENGTH, 1.0])
    body = BodyConstraint("the payload", np.arange(10), size)
    if float(np.linalg.eigvalsh(body.scaled_inertia(phi))[0]) >= MIN_EIGENVALUE:
        return phi
    # Scaled to a body of typical size, so that all unknowns of the conic program are of order one.
    scale = size[3] ** 2 * TYPICAL_LENGTH ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    quadratic = information * np.outer(scale, scale)
    largest = float(np.diag(quadratic).max())
    solution = minimise(
        quadratic / largest, np.zeros(10), Constraints(bodies=(body,), margin=MIN_EIGENVALUE), phi, np.diag(scale)
    )
    return np.asarray(phi + scale * solution.point)


def physical_components(phi: Array) -> Array:
    """Return mass, centre and inertia about it (10) for the parameters (10), in the order of ``Component``."""
    mass, centre, tensor = to_physical(phi, "the payload")
    return np.array([mass, *centre, *tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def physical_jacobian(phi: Array) -> Array:
    """Return the derivatives (10, 10) of ``physical_components`` by the parameters."""
    step = RELATIVE_STEP * abs(phi[0])
    ends = [[physical_components(phi + sign * step * direction) for direction in np.eye(10)] for sign in (1.0, -1.0)]
    return np.asarray((np.array(ends[0]) - np.array(ends[1])).T / (2 * step))


class Mount(Noun):
    """The ``frame``, a link of the robot file, on the moving ``body``, which ``joint`` moves.

    ``transform`` (p, 10) maps ten parameters in the frame to what they add to the parameters of the model.
    """

    frame: str
    body: str
    joint: str
    transform: Array


def mount_of(model: Model, frame: str | None = None) -> Mount:
    """Return the mount of a payload on the link ``frame``.

    The default is the flange of the last body, where a link of it is called so, else its first link. Raises
    ModelError where the model has no rigid bodies of a robot file, there is no such link, it does not move, or
    the arm has several ends and no frame is named.
    """
    bodies = next((term for term in model.terms if isinstance(term, RigidBodies)), None)
    if bodies is None:
        raise ModelError(f"{model.name}: has no links to carry a payload; identify with a URDF or MJCF.")
    links = {link: body for body in bodies.arm.bodies_with_parameters for link in body.links}
    if frame is None:
        frame = _flange(bodies)
    if frame not in links:
        if frame in bodies.arm.fixed_links:
            raise ModelError(f"the payload's frame {frame!r} does not move; {choices(frame, links)}")
        raise ModelError(f"the payload's frame {frame!r} is no link of {bodies.source}; {choices(frame, links)}")
    body = links[frame]
    placement = body.frames[body.links.index(frame)]
    columns = [
        k for k, parameter in enumerate(model.parameters) if parameter.body == body.name and parameter.role in INERTIAL
    ]
    transform = np.zeros((len(model.parameters), 10))
    # Inertial parameters are linear in a change of frame: the columns are the transformed unit bodies.
    transform[columns] = change_frame(np.eye(10), placement).T
    return Mount(frame, body.name, body.joint.name, transform)


def _flange(bodies: RigidBodies) -> str:
    """Return the frame of the arm's end; ModelError where there are several ends."""
    arm_bodies = bodies.arm.bodies
    parents = {body.parent for body in arm_bodies}
    ends = [body for k, body in enumerate(arm_bodies) if k not in parents and not body.massless]
    if len(ends) != 1:
        names = ", ".join(repr(body.name) for body in ends)
        raise ModelError(f"{bodies.source}: the arm has several ends ({names}); name the payload's frame.")
    return _named_flange(ends[0])


def _named_flange(body: ArmBody) -> str:
    """Return the link of a body that is called a flange, with or without a prefix, or the first."""
    for name in FLANGES:
        for link in body.links:
            if link.lower() == name or link.lower().endswith((f"_{name}", f"/{name}")):
                return link
    return body.name


class Turning(Noun):
    """A ``joint`` that turns back and forth at up to ``speed``, and the standard errors (10) of the payload after."""

    joint: str
    speed: float
    std: Array


def turnings(
    model: Model, mount: Mount, phi: Array, information: Array, variance: Array, poses: Array
) -> tuple[Turning, ...]:
    """Return for each joint that moves the payload what turning it alone would show, in the best of a few ``poses``.

    ``phi`` (10) are the parameters of the payload in its frame, with ``information`` (10, 10). ``variance`` (n) is
    that of a joint's torque over a second of motion. Friction is taken as known.
    """
    columns = np.flatnonzero(mount.transform.any(axis=1))
    moving = np.flatnonzero(model.support[:, columns].any(axis=1))
    J, results = physical_jacobian(phi), []
    for j in moving:
        speed, reach = _speed_and_reach(model, int(j))
        best = np.full(10, np.inf)
        # Gravity acts differently in each pose: a few of those recorded, spread evenly.
        for pose in poses[np.linspace(0, len(poses) - 1, N_POSES).astype(int)]:
            gained_information = _information_rate(
                model, mount, _centre_pose(model, int(j), pose, reach), (int(j), speed, reach), variance
            )
            covariance = J @ np.linalg.inv(information + MOTION_DURATION * gained_information) @ J.T
            best = np.minimum(best, np.sqrt(np.diag(covariance)))
        results.append(Turning(model.joints[j].name, speed, best))
    return tuple(results)


def best_turning(several: Sequence[Turning], component: int, std: float) -> Turning | None:
    """Return the motion that shows a component best; of joints that do about as well the one nearest to the payload.

    None where no motion lowers its standard error ``std`` by much.
    """
    smallest_std = min((turning.std[component] for turning in several), default=np.inf)
    best = [turning for turning in several if turning.std[component] <= 1.2 * smallest_std]
    return best[-1] if best and best[-1].std[component] <= MAX_HELPFUL_STD * std else None


def _speed_and_reach(model: Model, j: int) -> tuple[float, float]:
    """Return speed and reach of a joint's motion, within its limits where these are known."""
    joint, limit = model.joints[j], model.limits.get(model.joints[j].name)
    factor = SLIDE_FACTOR if joint.kind == "prismatic" else 1.0
    reach, speed = factor * MAX_REACH, factor * MAX_SPEED
    if limit is not None and limit.velocity:
        speed = min(speed, SPEED_LIMIT_SHARE * limit.velocity)
    return speed, reach


def _centre_pose(model: Model, j: int, pose: Array, reach: float) -> Array:
    """Return a pose (n) about which a joint can turn by ``reach`` without leaving its limits, as far as these allow."""
    limit, out = model.limits.get(model.joints[j].name), pose.copy()
    if limit is not None and limit.lower is not None and limit.upper is not None:
        free_reach = min(reach, (limit.upper - limit.lower) / 2)
        out[j] = np.clip(pose[j], limit.lower + free_reach, limit.upper - free_reach)
    return out


def _information_rate(
    model: Model, mount: Mount, pose: Array, motion: tuple[int, float, float], variance: Array
) -> Array:
    """Return the information (10, 10) on the payload from a second of a joint's motion about a pose (n)."""
    j, speed, reach = motion
    angle = np.linspace(0, 2 * np.pi, SAMPLES_PER_PERIOD, endpoint=False)
    q, dq, ddq = np.tile(pose, (SAMPLES_PER_PERIOD, 1)), *np.zeros((2, SAMPLES_PER_PERIOD, len(pose)))
    q[:, j] += reach * np.sin(angle)
    dq[:, j], ddq[:, j] = speed * np.cos(angle), -(speed**2) / reach * np.sin(angle)
    columns = np.flatnonzero(mount.transform.any(axis=1))
    alone = model.bodies
    place = {name: k for k, name in enumerate(alone.names)}
    Y = alone.regressor(q, dq, ddq)[:, :, [place[model.names[k]] for k in columns]] @ mount.transform[columns]
    # The mean over one period is the information per second, as the variance is per second.
    return np.asarray(np.einsum("tji,tjk,j->ik", Y, Y, 1.0 / variance)) / SAMPLES_PER_PERIOD


class NotShown(Note):
    """The motion with the payload does not show ``components`` of it, of standard errors ``std`` (SI).

    Ten seconds of turning ``joint`` alone, back and forth at up to ``speed`` (``unit`` rad/s, m/s), would lower them to
    ``then``; no joint is named where none would by itself.
    """

    advises = True
    components: tuple[Component, ...]
    std: tuple[float, ...]
    joint: str = ""
    speed: float = 0.0
    unit: str = "rad/s"
    then: tuple[float, ...] = ()

    def __str__(self) -> str:
        components = ", ".join(
            f"{name.meaning} (± {short(std, 2)} {name.unit})"
            for name, std in zip(self.components, self.std, strict=True)
        )
        text = f"the motion does not show {components} of the payload; "
        if not self.joint:
            return (
                f"{text}no single joint would by itself: turn the last joints together, fast, in several postures, as "
                "`dynident excite` designs it"
            )
        then = ", ".join(f"{short(std, 2)} {name.unit}" for name, std in zip(self.components, self.then, strict=True))
        return (
            f"{text}10 s of turning {self.joint} back and forth at up to {short(self.speed, 2)} {self.unit} would "
            f"lower that to ± {then}; `dynident excite` designs a motion of all joints"
        )


class PayloadOrDrift(Note):
    """``share`` of the variance of a ``component`` is due to drift of friction and offsets since the arm was
    identified: the data do not tell it from the payload. ``unloaded``: whether recordings without it were given."""

    advises = True
    component: Component
    share: float
    unloaded: bool

    def __str__(self) -> str:
        text = (
            f"{percent(100 * self.share, 2)} of the variance of the {self.component.meaning} is due to friction and "
            "offsets that may have changed since the arm was identified: the data do not tell that from the payload; "
        )
        if self.unloaded:
            return f"{text}move the arm through more postures, each joint in both directions"
        return f"{text}record the same motion without the payload on the same day (--unloaded)"


class GainsUnknown(Note):
    """The gains of the drives limit the mass: ``std`` (kg) in all, of which ``data`` (kg) were left if they were known.
    ``common`` (%) is how wrong all may be together."""

    severity = Severity.INFO
    std: float
    data: float
    common: float

    def __str__(self) -> str:
        return (
            f"the mass is known to ± {short(self.std, 2)} kg because the gains of the drives are taken as known to "
            f"{self.common:g} %; with known gains it would be ± {short(self.data, 2)} kg. A common error of all gains "
            "is only seen with a payload that was weighed (--known-mass, then --gains)"
        )


class NoPayload(Note):
    """The mass (kg) is less than three standard errors from nothing, so that nothing else is known of it."""

    mass: float
    std: float

    def __str__(self) -> str:
        return f"no payload is seen: {mass_bound(self.mass, self.std)}"


class OtherArm(Note):
    """What payload, drift and gains leave of the differences is ``factor`` times what the standard errors allow, by
    which these were multiplied."""

    factor: float

    def __str__(self) -> str:
        return (
            f"payload, drift and gains leave {short(self.factor, 2)} times what the standard errors allow, which are "
            "made larger by that: is this the arm that was identified, with the same tool, zeros and terms?"
        )


class SameRecording(Note):
    """A recording ``source`` without the payload is one that the result was fitted to; it counts there already."""

    severity = Severity.INFO
    source: str

    def __str__(self) -> str:
        return f"{self.source}: the result was identified from this recording already, so it is not used again"


def mass_bound(mass: float, std: float) -> str:
    """Return a mass (kg) with its standard error (kg), and what it is below, in words."""
    if std >= MAX_MASS / 2:  # what is known of the mass is its prior
        return "the motions turn no joint whose torque depends on its mass, so the mass stays unknown"
    bound = short(max(mass, 0.0) + 3 * std, 2)
    return f"its mass is {number_within(mass, std)} ± {number(std, 2)} kg, so it is below {bound} kg"
