"""The demo arm: six joints, its robot file as drawn, and what is true of it.

The robot file has each link as a capsule of one density. In truth a link's shell is lighter, and a motor sits in it
that no drawing has: masses are 5 to 15 % off and centres some cm, as of real arms, but the bodies are physical.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.demo.shapes import Capsule
from dynident.models import Coulomb, Model, Offset, RigidBodies, RotorInertia, Viscous, to_physical

__all__ = [
    "BASE", "JOINTS", "LINKS", "STEP", "TILT", "TIME_OFFSET", "DemoJoint", "DemoLink", "controller", "true_model",
    "true_values", "urdf",
]  # fmt: skip

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
TILT = (0.021, -0.015)  # rad about the x and y axes of the base: 1.5 deg
STEP = 1e-3  # s: the cycle of the drives
TIME_OFFSET = -0.003  # s: torques are logged so much late
Z, Y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class DemoJoint:
    """A joint in its parent's frame: origin (m), axis and limits (rad, N m, rad/s); then what is true of its drive, on
    the joint's side of the gear: rotor inertia (kg m^2), viscous and Coulomb friction, offset (N m), and the drive's
    gains: kp (1/s) and kv (N m s/rad)."""

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
    """A link as drawn, of a mass (kg); in truth the shell has another, and a ball of ``motor`` (kg) is at ``place``."""

    name: str
    shape: Capsule
    mass: float
    shell: float = 0.0
    motor: float = 0.0
    place: Vector = (0.0, 0.0, 0.0)

    @property
    def true(self) -> Array:
        """The ten parameters that the link has in truth."""
        ball = Capsule(self.place, self.place, 0.6 * self.shape.radius)
        return self.shape.inertia(self.shell) + ball.inertia(self.motor)


JOINTS = (
    DemoJoint("shoulder_pan", (0, 0, 0.16), Z, 2.9, 160, 3.2, 0.95, 9.0, 3.2, 0.6, 40, 440),
    DemoJoint("shoulder_lift", (0, 0, 0.18), Y, 2.0, 200, 3.2, 0.95, 11.0, 3.8, -0.9, 40, 500),
    DemoJoint("elbow", (0, 0, 0.42), Y, 2.6, 110, 3.6, 0.62, 6.0, 2.2, 0.5, 40, 200),
    DemoJoint("forearm_roll", (0, 0, 0.14), Z, 2.9, 40, 4.5, 0.21, 1.7, 0.7, -0.2, 40, 32),
    DemoJoint("wrist_pitch", (0, 0, 0.24), Y, 2.0, 40, 4.5, 0.18, 1.4, 0.6, 0.15, 40, 30),
    DemoJoint("wrist_roll", (0, 0, 0.09), Z, 2.9, 20, 5.0, 0.07, 0.5, 0.25, -0.08, 40, 11),
)
BASE = DemoLink("base", Capsule((0, 0, 0), (0, 0, 0.02), 0.06), 6.0)  # clear of the shoulder
LINKS = (
    DemoLink("shoulder", Capsule((0, 0, 0), (0, 0, 0.18), 0.075), 4.6, 3.1, 2.0, (0.0, -0.03, 0.15)),
    DemoLink("upper_arm", Capsule((0, 0.03, 0), (0, 0.03, 0.42), 0.065), 6.4, 4.4, 2.5, (0.01, 0.06, 0.37)),
    DemoLink("elbow_block", Capsule((0, 0, 0), (0, 0, 0.13), 0.06), 2.9, 1.9, 0.75, (-0.015, 0.03, 0.1)),
    DemoLink("forearm", Capsule((0, 0, 0.03), (0, 0, 0.24), 0.05), 2.0, 1.35, 0.9, (0.02, 0.01, 0.16)),
    DemoLink("wrist", Capsule((0, 0, 0), (0, 0, 0.07), 0.045), 1.1, 0.7, 0.52, (0.005, -0.02, 0.05)),
    DemoLink("hand", Capsule((0, 0, 0.03), (0.03, 0, 0.12), 0.04), 0.9, 0.62, 0.2, (0.03, 0.02, 0.1)),
)


def true_model() -> Model:
    """Return the arm as it is, with its terms in the order of ``dynident init`` and its base as it stands."""
    from dynident.identification import mounted

    bodies = RigidBodies(urdf(), source="arm.urdf")
    joints = bodies.joints
    terms = (bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints))
    return mounted(Model(terms, name="arm"), *TILT)


def true_values() -> Array:
    """Return the values (84) of the parameters of ``true_model``."""
    drives = [[getattr(joint, name) for joint in JOINTS] for name in ("rotor", "viscous", "coulomb", "offset")]
    return np.concatenate([*(link.true for link in LINKS), *drives])


def controller() -> str:
    """Return the drives' gains as the last part of a configuration, which makes its free simulation a closed loop."""
    lines = [
        f"    {joint.name}: {{ reference: {{ column: {joint.name}.reference_rad, unit: rad }}, "
        f"kp: {joint.kp}, kv: {joint.kv}, saturation: {joint.effort} }}"
        for joint in JOINTS
    ]
    head = (
        "simulation:  # of the recordings, in the loop of the controller that the arm had: kp in 1/s, kv in N m s/rad"
    )
    drives = f"  period: {STEP:g}  # s: the drives are four times as fast as the log"
    return "\n".join(("", head, "  kind: cascade", drives, "  joints:", *lines)) + "\n"


def urdf() -> str:
    """Return the robot file: inertias and friction as they would be in a drawing and a data sheet."""
    links = [_link(link) for link in (BASE, *LINKS)]
    parents = (BASE, *LINKS)
    joints = [_joint(joint, *ends) for joint, *ends in zip(JOINTS, parents, LINKS, strict=False)]
    head = (
        "<!-- The arm of `dynident demo`: drawn for it, no product. Its inertias are those of solid capsules. -->",
        '<robot name="demo_arm">',
        '  <mujoco><compiler strippath="false"/></mujoco>',
    )
    return "\n".join((*head, *links, *joints, "</robot>")) + "\n"


def _link(link: DemoLink) -> str:
    mass, centre, tensor = to_physical(link.shape.inertia(link.mass))
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    values = " ".join(f'{key}="{_number(tensor[place])}"' for key, place in places.items())
    mesh = f'<geometry><mesh filename="meshes/{link.name}.stl"/></geometry>'
    return f"""\
  <link name="{link.name}">
    <inertial>
      <origin xyz="{_vector(centre)}"/>
      <mass value="{_number(float(mass))}"/>
      <inertia {values}/>
    </inertial>
    <visual>{mesh}</visual>
    <collision>{mesh}</collision>
  </link>"""


def _joint(joint: DemoJoint, parent: DemoLink, child: DemoLink) -> str:
    return f"""\
  <joint name="{joint.name}" type="revolute">
    <parent link="{parent.name}"/>
    <child link="{child.name}"/>
    <origin xyz="{_vector(joint.origin)}"/>
    <axis xyz="{_vector(joint.axis)}"/>
    <limit lower="{-joint.reach}" upper="{joint.reach}" effort="{joint.effort}" velocity="{joint.velocity}"/>
  </joint>"""


def _vector(values: Iterable[float]) -> str:
    return " ".join(_number(float(value)) for value in values)


def _number(value: float) -> str:
    """Return a number with six digits, as a drawing has it; without a sign where it is zero."""
    return f"{float(f'{value:.6g}') + 0.0:.6g}"
