"""The demo arm: six joints, its robot file as drawn, and its true parameters.

The robot file has each link as a capsule of one density. In truth a link's shell is lighter, and has a motor
that is in no drawing: masses are 5 to 15 % off and centres some cm, as of real arms, but the bodies are
physical.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.models import Model, RigidBodies, RotorInertia, from_physical, to_physical
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

FACETS_AROUND, FACETS_ALONG = 16, 4  # facets around a capsule, and from its end to its cylinder
Vector = tuple[float, float, float]
TILT = (0.021, -0.015)  # rad about the x and y axes of the base: 1.5 deg
STEP = 1e-3  # s: the cycle of the drives
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

    def stl(self) -> bytes:
        """Return the surface as binary STL, with normals outwards."""
        corners = self._corners()
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sizes = np.linalg.norm(normals, axis=1, keepdims=True)
        has_area = sizes[:, 0] > 0  # a ball has no cylinder
        corners, normals = corners[has_area], normals[has_area] / sizes[has_area]
        facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        facets["normal"], facets["corners"] = normals, corners
        return b"dynident demo arm".ljust(80) + len(corners).to_bytes(4, "little") + facets.tobytes()

    def _corners(self) -> Array:
        """Return the corners (facets, 3, 3) of triangles, counter-clockwise from outside."""
        x, y, z = _frame(np.subtract(self.end, self.start))
        up = np.linspace(-np.pi / 2, np.pi / 2, 2 * FACETS_ALONG)
        up[FACETS_ALONG - 1], up[FACETS_ALONG] = 0.0, 0.0  # the ends of the cylinder
        across = np.cos(up)
        across[0], across[-1] = 0.0, 0.0
        turn = 2 * np.pi * np.arange(FACETS_AROUND) / FACETS_AROUND
        ring = np.outer(np.cos(turn), x) + np.outer(np.sin(turn), y)
        middle = np.where(np.arange(len(up))[:, None] < FACETS_ALONG, self.start, self.end)
        axes = middle + self.radius * np.outer(np.sin(up), z)
        # rings of points from pole to pole; two triangles join each pair of neighbours on adjacent rings
        rings = axes[:, None] + self.radius * across[:, None, None] * ring
        low, high = rings[:-1], rings[1:]
        next_points = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
        lower_triangles = np.stack((low, next_points[0], next_points[1]), axis=2)[1:]  # the first ring is a point
        upper_triangles = np.stack((low, next_points[1], high), axis=2)[:-1]  # and so is the last
        return np.concatenate((lower_triangles.reshape(-1, 3, 3), upper_triangles.reshape(-1, 3, 3)))


def _frame(along: Array) -> Array:
    """Return three axes (3, 3), the last of them along a vector; any of them where it is zero."""
    size = np.linalg.norm(along)
    z = along / size if size else np.array([0.0, 0.0, 1.0])
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


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
    links = [_link_xml(link) for link in (BASE, *LINKS)]
    parents = (BASE, *LINKS)
    joints = [_joint_xml(joint, *ends) for joint, *ends in zip(JOINTS, parents, LINKS, strict=False)]
    head = (
        "<!-- The arm of `dynident demo`: drawn for it, no product. Its inertias are those of solid capsules. -->",
        '<robot name="demo_arm">',
        '  <mujoco><compiler strippath="false"/></mujoco>',
    )
    return "\n".join((*head, *links, *joints, "</robot>")) + "\n"


def _link_xml(link: DemoLink) -> str:
    mass, centre, tensor = to_physical(link.shape.inertia(link.mass))
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    values = " ".join(f'{key}="{_format_number(tensor[place])}"' for key, place in places.items())
    mesh = f'<geometry><mesh filename="meshes/{link.name}.stl"/></geometry>'
    return f"""\
  <link name="{link.name}">
    <inertial>
      <origin xyz="{_format_vector(centre)}"/>
      <mass value="{_format_number(float(mass))}"/>
      <inertia {values}/>
    </inertial>
    <visual>{mesh}</visual>
    <collision>{mesh}</collision>
  </link>"""


def _joint_xml(joint: DemoJoint, parent: DemoLink, child: DemoLink) -> str:
    return f"""\
  <joint name="{joint.name}" type="revolute">
    <parent link="{parent.name}"/>
    <child link="{child.name}"/>
    <origin xyz="{_format_vector(joint.origin)}"/>
    <axis xyz="{_format_vector(joint.axis)}"/>
    <limit lower="{-joint.reach}" upper="{joint.reach}" effort="{joint.effort}" velocity="{joint.velocity}"/>
  </joint>"""


def _format_vector(values: Iterable[float]) -> str:
    return " ".join(_format_number(float(value)) for value in values)


def _format_number(value: float) -> str:
    """Return a number with six digits, as in a drawing, and without a sign where it is zero."""
    return f"{float(f'{value:.6g}') + 0.0:.6g}"


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
