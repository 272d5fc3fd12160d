"""The rigid bodies of a robot file (URDF or MJCF), and the regressor of their inertial parameters.

The file is parsed in ``robot_file``, so that nothing in it is ignored silently; ``recursion.py`` computes the dynamics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from pathlib import PurePath
from reprlib import repr as short_repr
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.models.recursion import Recursion
from dynident.models.recursion_kernel import make_recursion
from dynident.models.robot_files import (
    Arm,
    LinkShapes,
    RobotFile,
    RobotJoint,
    RobotJointLimits,
    assemble,
    displace_joints,
    mjcf_shapes,
    parse,
    read_mjcf,
    read_urdf,
    urdf_shapes,
)
from dynident.models.term import INERTIAL, Joint, Parameter, Partials, Term
from dynident.models.tree import Layout, Tree
from dynident.runtime import ModelError, Noun, join_names
from dynident.runtime.arrays import Array

Integers = NDArray[np.intp]


class Placements(Noun):
    """Axes ``rotations`` (N, B, 3, 3) and ``origins`` (N, B, 3) (m) of B bodies at N samples, and the ``axes``
    (N, B, 3) of their joints, all in the frame of the root link. The bodies are those of ``RigidBodies.arm.bodies``.

    In all methods ``body`` (P) holds the bodies of P points; -1 is the root link, which does not move.
    """

    layout: Layout
    rotations: Array
    origins: Array
    axes: Array

    def points(self, body: ArrayLike, local: ArrayLike) -> Array:
        """Return points (N, P, 3) that are at ``local`` (P, 3) in the frames of their bodies."""
        body, local = np.asarray(body, dtype=np.intp), np.asarray(local, dtype=float)
        in_root = (self.rotations[:, body] @ local[:, :, None])[..., 0] + self.origins[:, body]
        return np.where((body < 0)[:, None], local, in_root)

    def project_on_joints(self, body: ArrayLike, points: Array, along: Array) -> Array:
        """Return the products J' along (N, P, n) of the Jacobians of points (N, P, 3) with vectors (N, P, 3).

        They are the rates by which a motion of each joint moves the points of bodies along the vectors ``along``;
        where the vectors are forces on the points, they are the torques of the joints.
        """
        layout = self.layout
        # screws of the joints at the origin of the root link: rotation, and velocity of the point that is there
        revolute, prismatic = ~layout.prismatic[:, None], layout.prismatic[:, None]
        rotations = self.axes * revolute
        velocities = self.axes * prismatic - np.cross(rotations, self.origins)
        # moment and force about the same origin, so that their product with the screws is the torque
        wrench = np.concatenate((np.cross(points, along), along), axis=2)
        by_body = wrench @ np.concatenate((rotations, velocities), axis=2).swapaxes(1, 2)
        # ones (P, B) where a body (column) is that of a point (row) or carries it
        body = np.asarray(body, dtype=np.intp)
        carriers = layout.above[body] * (body >= 0)[:, None]
        return np.asarray((by_body * carriers) @ layout.drive)


def placements(tree: Tree, first_origin: Array, q: Array) -> Placements:
    """Return the placements of a tree at positions q (N, n), rad or m.

    ``first_origin`` (3) is where the first body begins. Raises ModelError where q has another shape.
    """
    layout = tree.layout
    if q.ndim != 2 or q.shape[1] != layout.joints:
        raise ModelError(f"q has the shape {q.shape}, expected (N, {layout.joints}).")
    q = q @ layout.drive.T + layout.offset
    sine, cosine = (wave(q)[..., None, None] for wave in (np.sin, np.cos))
    # Rodrigues: rotations of the joints by sine and cosine, see ``Tree``
    relative = tree.turns[0] + sine * tree.turns[1] + cosine * tree.turns[2]
    offset = tree.origin + (layout.prismatic * q)[..., None] * tree.axis
    R, p, z = np.empty((*q.shape, 3, 3)), np.empty((*q.shape, 3)), np.empty((*q.shape, 3))
    # from the base to the tips: parents come before their children
    for k, parent in enumerate(layout.parent):
        if parent < 0:
            R[:, k], p[:, k], z[:, k] = relative[:, k], first_origin + offset[:, k], tree.axis[k]
        else:
            R[:, k] = R[:, parent] @ relative[:, k]
            p[:, k] = p[:, parent] + (R[:, parent] @ offset[:, k, :, None])[..., 0]
            z[:, k] = R[:, parent] @ tree.axis[k]
    return Placements(layout, R, p, z)


READERS = {"robot": read_urdf, "mujoco": read_mjcf}
SDF = " SDF is not read: export the robot as a URDF, from which most SDF files are made, or as an MJCF."
UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
MEANINGS = (
    "mass",
    *(f"mass times the {axis} of the centre of mass" for axis in "xyz"),
    *(f"inertia {name[1:]} about the origin of the joint frame" for name in INERTIAL[4:]),
)


@dataclass(frozen=True)
class RigidBodies(Term):
    """The rigid-body term of a robot: ten inertial parameters for each moving link, about its joint's frame.

    ``xml`` is the text of a URDF or MJCF file. ``joints_used`` chooses the moving joints and their order (default:
    all that are not locked, from base to tip); all others are fixed at their value in ``locked`` (rad or m), else at
    zero, a mimic joint at the value it follows. ``gravity`` (3), in m/s^2, is given in the frame of the root link: for
    a rotated base, rotate gravity. Links that are fixed to each other are one body, named after the child link of its
    joint. ``source`` names the file in messages. ``displacements`` move the frames of joints, as ``with_displacement``
    does.

    Raises ModelError where the file is not well-formed or contradicts itself, joints are unknown, or a moving joint
    is not revolute, continuous or prismatic, mimics another, or is part of a closed loop. Inconsistent inertias are no
    error, because they are only nominal values: see ``notes``.

    >>> import dynident as dy
    >>> text = '''<robot name="door"><link name="wall"/><link name="leaf"><inertial><origin xyz="0.4 0 0"/>
    ... <mass value="20"/><inertia ixx="3" iyy="1" izz="4" ixy="0" ixz="0" iyz="0"/></inertial></link>
    ... <joint name="hinge" type="continuous"><parent link="wall"/><child link="leaf"/><axis xyz="0 1 0"/></joint>
    ... </robot>'''
    >>> leaf = dy.RigidBodies(text, source="door.urdf")
    >>> leaf
    <RigidBodies of 'door.urdf' (urdf): hinge; 10 parameters>
    >>> {parameter.name: parameter.value for parameter in leaf.parameters[:2]}
    {'leaf.mass': 20.0, 'leaf.mx': 8.0}
    """

    loads: ClassVar[bool] = True
    xml: str
    joints_used: tuple[str, ...] | None = None
    locked: Mapping[str, float] | tuple[tuple[str, float], ...] = ()
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    source: str = "robot"
    displacements: tuple[tuple[str, tuple[float, ...]], ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.xml, str) or (
            "<" not in self.xml and "\n" not in self.xml and PurePath(self.xml).suffix
        ):
            raise ModelError(
                f"RigidBodies: xml is {short_repr(self.xml)}; it is the text of a robot file. From its path a model is "
                f"made by `dynident.read_robot({str(self.xml)!r})`."
            )
        pairs = self.locked.items() if isinstance(self.locked, Mapping) else self.locked
        object.__setattr__(self, "locked", tuple((str(name), float(value)) for name, value in pairs))
        object.__setattr__(self, "gravity", tuple(float(x) for x in self.gravity))
        if self.joints_used is not None:
            object.__setattr__(self, "joints_used", tuple(self.joints_used))
        if len(self.gravity) != 3 or not np.isfinite(self.gravity).all():
            raise ModelError(f"{self.source}: gravity is {self.gravity}; give three numbers in m/s^2: x, y, z.")
        _ = self.arm

    def __repr__(self) -> str:
        names = join_names((joint.name for joint in self.joints), 6)
        return f"<RigidBodies of {self.source!r} ({self.format}): {names}; {len(self.parameters)} parameters>"

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def format(self) -> Literal["urdf", "mjcf"]:
        """Format of the file, by its root element: "urdf" or "mjcf"."""
        return self.file.format

    @cached_property
    def file(self) -> RobotFile:
        """The parsed file, before links are merged."""
        return read_robot_file(self.xml, self.source)

    @cached_property
    def arm(self) -> Arm:
        """The moving bodies, with the links of each."""
        arm = self._undisplaced_arm
        return displace_joints(arm, dict(self.displacements)) if self.displacements else arm

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The n moving joints, in the chosen order."""
        return tuple(
            Joint(joint.name, "prismatic" if joint.kind == "prismatic" else "revolute") for joint in self._driven_joints
        )

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Ten parameters per moving body, in the order of ``joints`` and INERTIAL, with the file's values.

        The value is None for a body with a link whose inertia the file leaves to be computed from shapes.
        """
        return _parameters(self._undisplaced_arm)

    @property
    def limits(self) -> dict[str, RobotJointLimits]:
        """Limits of each moving joint, where the file gives them."""
        return {joint.name: joint.limits for joint in self._driven_joints}

    @property
    def shapes(self) -> dict[str, LinkShapes]:
        """The shapes of the links that have any in the file; ModelError for one with a wrong size."""
        root = parse(self.xml, self.source)
        if self.format == "urdf":
            return urdf_shapes(root, self.source)
        return mjcf_shapes(root, self.source, self.file.origins)

    @property
    def damping(self) -> dict[str, float]:
        """Nominal viscous friction, in N m s/rad or N s/m, of the moving joints for which the file gives one."""
        return self._nominal("damping")

    @property
    def friction(self) -> dict[str, float]:
        """Nominal Coulomb friction, in N m or N, of the moving joints for which the file gives one."""
        return self._nominal("friction")

    @property
    def armature(self) -> dict[str, float]:
        """Nominal rotor inertia, in kg m^2 or kg, of the moving joints for which the file gives one."""
        return self._nominal("armature")

    @property
    def merged_links(self) -> dict[str, tuple[str, ...]]:
        """Body -> other links fixed to it, if any; the root link has those that do not move."""
        owners = {body.name: body.links for body in self.arm.bodies_with_parameters}
        fixed = {self.file.root: self.arm.fixed_links}
        return {name: links[1:] for name, links in (fixed | owners).items() if len(links) > 1}

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what of the file is ignored; what is wrong in it, ``checks`` find."""
        notes = list(self.file.notes)
        limbs = self.file.limbs({body.joint.name for body in self.arm.bodies})
        if limbs and not self.file.floating:
            notes.append(f"{len(limbs[1])} limbs move from the base {limbs[0]!r}, which is taken as fixed")
        notes += [
            f"body {body.name!r}: its inertia follows from meshes that were not found"
            for body in self.arm.bodies_with_parameters
            if np.isnan(body.theta).any()
        ]
        return tuple(f"{self.source}: {note}." for note in notes)

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y, shape (N, n, 10 n), for q, dq, ddq (N, n) in rad or m, per s and s^2."""
        return self.recursion.regressor(_floats(q), _floats(dq), _floats(ddq))

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, 10 n)."""
        return self.recursion.layout.support

    def entries(  # type: ignore[override] # it remembers nothing
        self, q: Array, dq: Array, ddq: Array, joint: NDArray[np.intp], parameter: NDArray[np.intp]
    ) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows m, shape (M, N); ModelError where there is no such entry."""
        rows, columns = np.asarray(joint, dtype=np.intp), np.asarray(parameter, dtype=np.intp)
        shape = self.support.shape
        # the kernel would read beyond its arrays for other indices
        if rows.ndim != 1 or columns.shape != rows.shape:
            raise ModelError(f"{self.source}: joint and parameter have the shapes {rows.shape}, {columns.shape}.")
        if len(rows) and (min(rows.min(), columns.min()) < 0 or rows.max() >= shape[0] or columns.max() >= shape[1]):
            raise ModelError(
                f"{self.source}: joint or parameter is not an index of a regressor (N, {shape[0]}, {shape[1]})."
            )
        return self.recursion.entries(_floats(q), _floats(dq), _floats(ddq), rows, columns)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        """Return the derivatives of Y theta by q, dq and ddq, each (N, n, n), for any theta (10 n), physical or not."""
        dynamics = self.recursion
        states = _floats(q), _floats(dq), _floats(ddq)
        return Partials(*dynamics.partials(*states, dynamics.layout.expand_parameters(theta)))

    def weighted_gradient(  # type: ignore[override]
        self, q: Array, dq: Array, ddq: Array, weights: Array
    ) -> Array:
        """Return the derivatives (3, N, n) by q, dq and ddq of the sums <G_i, Y_i> for weights G (N, n, 10 n)."""
        states, weights = (_floats(q), _floats(dq), _floats(ddq)), _floats(weights)
        if weights.shape != (shape := (len(states[0]), *self.support.shape)):
            raise ModelError(f"{self.source}: the weights have the shape {weights.shape}, expected {shape}.")
        return self.recursion.weighted_gradient(*states, weights)

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return Y theta, shape (N, n), for any theta (10 n), physical or not."""
        dynamics = self.recursion
        return dynamics.torque(_floats(q), _floats(dq), _floats(ddq), dynamics.layout.expand_parameters(theta))

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n) and the torque (N, n) without acceleration, for any theta (10 n)."""
        dynamics = self.recursion
        return dynamics.mass_and_bias(_floats(q), _floats(dq), dynamics.layout.expand_parameters(theta))

    def placements(self, q: Array) -> Placements:
        """Return where the bodies ``arm.bodies`` are at positions q (N, n), in the frame of the root link."""
        return placements(self.recursion.tree, self.arm.bodies[0].placement[:3, 3], _floats(q))

    def with_gravity(self, gravity: tuple[float, ...]) -> RigidBodies:
        """Return the bodies under another gravity (3), m/s^2."""
        x, y, z = gravity
        return replace(self, gravity=(x, y, z))

    def with_displacement(self, joint: str, by: tuple[float, ...]) -> RigidBodies:
        """Return the bodies with a joint displaced further by (9), as ``Term`` says."""
        displacements = dict(self.displacements)
        total = np.add(displacements.get(joint, np.zeros(9)), by).tolist()
        return replace(self, displacements=tuple((displacements | {joint: tuple(total)}).items()))

    def _nominal(self, key: str) -> dict[str, float]:
        return {joint.name: joint.nominal[key] for joint in self._driven_joints if key in joint.nominal}

    @cached_property
    def _undisplaced_arm(self) -> Arm:
        """The bodies before they are displaced."""
        return _assemble_file(self.xml, self.source, self.joints_used, tuple(self.locked))

    @cached_property
    def recursion(self) -> Recursion:
        """The dynamics, by the kernel where there is one."""
        layout = _layout(self._undisplaced_arm)  # displaced joints do not change it
        tree = Tree.of(self.arm, layout) if self.displacements else _tree(self.arm, layout)
        return make_recursion(tree, np.array(self.gravity))

    @property
    def _driven_joints(self) -> list[RobotJoint]:
        """The joints, in the chosen order."""
        return [self.arm.bodies[k].joint for k in self.arm.driven]


@lru_cache(maxsize=8)
def read_robot_file(xml: str, source: str) -> RobotFile:
    """Parse the text of a URDF or MJCF file; ModelError where it is neither, or contradicts itself.

    The result is cached, because displaced or tilted bodies have the same text.
    """
    root = parse(xml, source)
    if root.tag not in READERS:
        raise ModelError(
            f"{source}: the root element is <{root.tag}>; a URDF begins with <robot>, an MJCF with <mujoco>."
            f"{SDF if root.tag == 'sdf' else ''}"
        )
    return READERS[root.tag](root, source)


@lru_cache(maxsize=8)
def _assemble_file(
    xml: str, source: str, joint_names: tuple[str, ...] | None, locked: tuple[tuple[str, float], ...]
) -> Arm:
    """Return the bodies of a file before they are displaced; the result is cached, as that of the parser is."""
    return assemble(read_robot_file(xml, source), joint_names, dict(locked))


# cached, because bodies under another gravity have the same
_layout, _tree = lru_cache(maxsize=8)(Layout.of), lru_cache(maxsize=8)(Tree.of)


@lru_cache(maxsize=8)
def _parameters(arm: Arm) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"{body.name}.{role}", unit, f"{meaning} of {body.name}", value, role, body.name)
        for body in arm.bodies_with_parameters
        for role, unit, meaning, value in zip(
            INERTIAL, UNITS, MEANINGS, [None] * 10 if np.isnan(body.theta).any() else body.theta.tolist(), strict=True
        )
    )


def _floats(states: Array) -> Array:
    return np.ascontiguousarray(states, dtype=float)
