"""The demo arm: six joints, its robot file as drawn, and its true parameters.

The robot file has each link as a capsule of one density. In truth a link's shell is lighter, and has a motor
that is in no drawing: masses are 5 to 15 % off and centres some cm, as of real arms, but the bodies are
physical.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from dynident.models import Model, RigidBodies, RotorInertia, from_physical
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

Vector = tuple[float, float, float]
TILT = (0.021, -0.015)  # rad about the x and y axes of the base: 1.5 deg
TIME_OFFSET = -0.003  # s: torques are logged so much late
Z, Y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class LinkCapsule:
    """A cylinder with hemispherical ends, from ``start`` to ``end`` (m, in the link's frame)."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float

    def inertia(self, mass: float) -> Array:
        """Return the ten inertial parameters of a capsule of uniform density and this mass (kg)."""
        along, r = np.subtract(self.end, self.start), self.radius
        L = float(np.linalg.norm(along))
        # a cylinder and two hemispheres, which share the mass by volume
        tube = mass * L / (L + 4 * r / 3)
        balls = mass - tube
        axial = tube * r**2 / 2 + balls * 2 * r**2 / 5
        across = tube * (L**2 / 12 + r**2 / 4) + balls * (2 * r**2 / 5 + L**2 / 4 + 3 * L * r / 8)
        u = along / L if L else np.zeros(3)
        tensor = across * np.eye(3) + (axial - across) * np.outer(u, u)
        return from_physical(mass, np.add(self.start, self.end) / 2, tensor)


@dataclass(frozen=True)
class DemoJoint:
    """A joint of the demo arm, and the true values of its drive.

    In its parent's frame: origin (m), axis and limits (rad, N m, rad/s). On the joint's side of the gear: rotor
    inertia (kg m^2), viscous and Coulomb friction, offset (N m), and the gains kp (1/s) and kv (N m s/rad).
    """

    name: str
    origin: Vector
    axis: Vector
    reach: float
    effort: float
    velocity: float
    rotor: float
    viscous: float
    coulomb: float
    offset: float
    kp: float
    kv: float


@dataclass(frozen=True)
class DemoLink:
    """A link as drawn, with its mass (kg), and as it is in truth.

    Its shell has ``shell_mass`` (kg), and a ball of ``motor_mass`` (kg) is at ``motor_position``.
    """

    name: str
    shape: LinkCapsule
    mass: float
    shell_mass: float = 0.0
    motor_mass: float = 0.0
    motor_position: Vector = (0.0, 0.0, 0.0)

    @property
    def true_parameters(self) -> Array:
        """The ten true parameters of the link."""
        ball = LinkCapsule(self.motor_position, self.motor_position, 0.6 * self.shape.radius)
        return self.shape.inertia(self.shell_mass) + ball.inertia(self.motor_mass)


JOINTS = (
    DemoJoint("shoulder_pan", (0, 0, 0.16), Z, 2.9, 160, 3.2, 0.95, 9.0, 3.2, 0.6, 40, 440),
    DemoJoint("shoulder_lift", (0, 0, 0.18), Y, 2.0, 200, 3.2, 0.95, 11.0, 3.8, -0.9, 40, 500),
    DemoJoint("elbow", (0, 0, 0.42), Y, 2.6, 110, 3.6, 0.62, 6.0, 2.2, 0.5, 40, 200),
    DemoJoint("forearm_roll", (0, 0, 0.14), Z, 2.9, 40, 4.5, 0.21, 1.7, 0.7, -0.2, 40, 32),
    DemoJoint("wrist_pitch", (0, 0, 0.24), Y, 2.0, 40, 4.5, 0.18, 1.4, 0.6, 0.15, 40, 30),
    DemoJoint("wrist_roll", (0, 0, 0.09), Z, 2.9, 20, 5.0, 0.07, 0.5, 0.25, -0.08, 40, 11),
)
BASE = DemoLink("base", LinkCapsule((0, 0, 0), (0, 0, 0.02), 0.06), 6.0)  # clear of the shoulder
LINKS = (
    DemoLink("shoulder", LinkCapsule((0, 0, 0), (0, 0, 0.18), 0.075), 4.6, 3.1, 2.0, (0.0, -0.03, 0.15)),
    DemoLink("upper_arm", LinkCapsule((0, 0.03, 0), (0, 0.03, 0.42), 0.065), 6.4, 4.4, 2.5, (0.01, 0.06, 0.37)),
    DemoLink("elbow_block", LinkCapsule((0, 0, 0), (0, 0, 0.13), 0.06), 2.9, 1.9, 0.75, (-0.015, 0.03, 0.1)),
    DemoLink("forearm", LinkCapsule((0, 0, 0.03), (0, 0, 0.24), 0.05), 2.0, 1.35, 0.9, (0.02, 0.01, 0.16)),
    DemoLink("wrist", LinkCapsule((0, 0, 0), (0, 0, 0.07), 0.045), 1.1, 0.7, 0.52, (0.005, -0.02, 0.05)),
    DemoLink("hand", LinkCapsule((0, 0, 0.03), (0.03, 0, 0.12), 0.04), 0.9, 0.62, 0.2, (0.03, 0.02, 0.1)),
)


def true_model() -> Model:
    """Return the true arm, with its terms in the order of ``dynident init`` and its tilted base."""
    from dynident.identification import tilt_base

    bodies = RigidBodies(urdf(), source="arm.urdf")
    joints = bodies.joints
    terms = (bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints))
    return tilt_base(Model(terms, name="arm"), *TILT)


def true_values() -> Array:
    """Return the values (84) of the parameters of ``true_model``."""
    drives = [[getattr(joint, name) for joint in JOINTS] for name in ("rotor", "viscous", "coulomb", "offset")]
    return np.concatenate([*(link.true_parameters for link in LINKS), *drives])


def urdf() -> str:
    """Return the robot file: inertias and friction as they would be in a drawing and a data sheet."""
    return (files("dynident.apps.demo") / "files" / "arm.urdf").read_text(encoding="utf-8")


class DemoTruth(Noun):
    """The truth about the demo arm.

    The ``model`` on its tilted base, with the parameters that ``dynident identify`` estimates, and their true
    ``value`` (84); the ``time_offset`` (s) of its recordings, negative as torques are logged late; the ``tilt``
    (rad) of its base about the x and y axes.
    """

    model: Model
    value: NDArray[np.float64]
    time_offset: float
    tilt: tuple[float, float]


def demo_truth() -> DemoTruth:
    """Return the truth about the demo arm.

    >>> truth = demo_truth()
    >>> truth.value[truth.model.names.index("Fv_elbow")].item()
    6.0
    """
    return DemoTruth(true_model(), true_values(), TIME_OFFSET, TILT)
