"""The rigid bodies of a robot file (URDF or MJCF), and the regressor of their inertial parameters.

The file is parsed in ``robot_file``, so that nothing in it is ignored silently; ``recursion.py`` computes the dynamics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, listed
from dynident.models.inertia import consistency_violations
from dynident.models.placements import Placements, placements
from dynident.models.recursion import Recursion
from dynident.models.recursion_kernel import recursion
from dynident.models.robot_file import (
    Arm,
    ArmBody,
    Limits,
    LinkShapes,
    RobotFile,
    RobotJoint,
    assemble,
    displaced,
    mjcf_shapes,
    parse,
    read_mjcf,
    read_urdf,
    urdf_shapes,
)
from dynident.models.term import INERTIAL, Joint, Parameter, Partials
from dynident.models.tree import Layout, Tree

__all__ = ["RigidBodies", "read_robot_file"]

Array = NDArray[np.float64]
READERS = {"robot": read_urdf, "mujoco": read_mjcf}
SDF = " SDF is not read: export the robot as a URDF, from which most SDF files are made, or as an MJCF."
UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
MEANINGS = (
    "mass",
    *(f"mass times the {axis} of the centre of mass" for axis in "xyz"),
    *(f"inertia {name[1:]} about the origin of the joint frame" for name in INERTIAL[4:]),
)


@dataclass(frozen=True)
class RigidBodies:
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
    >>> {one.name: one.value for one in leaf.parameters[:2]}
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
        pairs = self.locked.items() if isinstance(self.locked, Mapping) else self.locked
        object.__setattr__(self, "locked", tuple((str(name), float(value)) for name, value in pairs))
        object.__setattr__(self, "gravity", tuple(float(x) for x in self.gravity))
        if self.joints_used is not None:
            object.__setattr__(self, "joints_used", tuple(self.joints_used))
        if len(self.gravity) != 3 or not np.isfinite(self.gravity).all():
            raise ModelError(f"{self.source}: gravity is {self.gravity}; give three numbers in m/s^2: x, y, z.")
        _ = self._arm

    def __repr__(self) -> str:
        names = listed((joint.name for joint in self.joints), 6)
        return f"<RigidBodies of {self.source!r} ({self.format}): {names}; {len(self.parameters)} parameters>"

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def format(self) -> Literal["urdf", "mjcf"]:
        """Format of the file, by its root element: "urdf" or "mjcf"."""
        return self._file.format

    @property
    def file(self) -> RobotFile:
        """The parsed file, before links are merged."""
        return self._file

    @property
    def arm(self) -> Arm:
        """The moving bodies, with the links of each."""
        return self._arm

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The n moving joints, in the chosen order."""
        return tuple(
            Joint(joint.name, "prismatic" if joint.kind == "prismatic" else "revolute") for joint in self._driven
        )

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Ten parameters per moving body, in the order of ``joints`` and INERTIAL, with the file's values.

        The value is None for a body with a link whose inertia the file leaves to be computed from shapes.
        """
        return _parameters(self._assembled)

    @property
    def limits(self) -> dict[str, Limits]:
        """Limits of each moving joint, where the file gives them."""
        return {joint.name: joint.limits for joint in self._driven}

    @property
    def shapes(self) -> dict[str, LinkShapes]:
        """The shapes of the links that have any in the file; ModelError for one with a wrong size."""
        root = parse(self.xml, self.source)
        if self.format == "urdf":
            return urdf_shapes(root, self.source)
        return mjcf_shapes(root, self.source, self._file.origins)

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
    def merged(self) -> dict[str, tuple[str, ...]]:
        """Body -> other links fixed to it, if any; the root link has those that do not move."""
        owners = {body.name: body.links for body in self._arm.chosen}
        still = {self._file.root: self._arm.still}
        return {name: links[1:] for name, links in (still | owners).items() if len(links) > 1}

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what of the file is ignored, and on its inertias that are not physically consistent."""
        notes = list(self._file.notes)
        if self._file.floating:
            names = ", ".join(map(repr, self._file.floating))
            notes.append(f"the robot floats by {names}, but only a fixed base is supported: it is taken as fixed")
        elif limbs := self._file.limbs({body.joint.name for body in self._arm.bodies}):
            notes.append(f"{len(limbs[1])} limbs move from the base {limbs[0]!r}, which is taken as fixed")
        if self._file.gravity not in (None, self.gravity):
            notes.append(f"the file's gravity {self._file.gravity} is ignored; {self.gravity} m/s^2 is used")
        for body in self._arm.chosen:
            if np.isnan(body.theta).any():
                notes.append(f"body {body.name!r}: its inertia follows from meshes, which are not read")
            elif not body.theta.any():
                notes.append(f"body {body.name!r}: the file gives no inertia")
            else:
                notes += [f"body {body.name!r}: {violation}" for violation in consistency_violations(body.theta)]
        return tuple(f"{self.source}: {note}." for note in notes)

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y, shape (N, n, 10 n), for q, dq, ddq (N, n) in rad or m, per s and s^2."""
        return self._recursion.regressor(_floats(q), _floats(dq), _floats(ddq))

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, 10 n)."""
        return self._recursion.layout.support

    def entries(self, q: Array, dq: Array, ddq: Array, joint: NDArray[np.intp], parameter: NDArray[np.intp]) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows m, shape (M, N); ModelError where there is no such entry."""
        rows, columns = np.asarray(joint, dtype=np.intp), np.asarray(parameter, dtype=np.intp)
        of = self.support.shape
        if rows.ndim != 1 or columns.shape != rows.shape:
            raise ModelError(f"{self.source}: joint and parameter have the shapes {rows.shape}, {columns.shape}.")
        if len(rows) and (min(rows.min(), columns.min()) < 0 or rows.max() >= of[0] or columns.max() >= of[1]):
            raise ModelError(f"{self.source}: joint or parameter is not an index of a regressor (N, {of[0]}, {of[1]}).")
        return self._recursion.entries(_floats(q), _floats(dq), _floats(ddq), rows, columns)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        """Return the derivatives of Y theta by q, dq and ddq, each (N, n, n), for any theta (10 n), physical or not."""
        dynamics = self._recursion
        states = _floats(q), _floats(dq), _floats(ddq)
        return Partials(*dynamics.partials(*states, dynamics.layout.filled(theta)))

    def weighted_gradient(self, q: Array, dq: Array, ddq: Array, weights: Array) -> Array:
        """Return the derivatives (3, N, n) by q, dq and ddq of the sums <G_i, Y_i> for weights G (N, n, 10 n)."""
        states, weights = (_floats(q), _floats(dq), _floats(ddq)), _floats(weights)
        if weights.shape != (shape := (len(states[0]), *self.support.shape)):
            raise ModelError(f"{self.source}: the weights have the shape {weights.shape}, expected {shape}.")
        return self._recursion.weighted_gradient(*states, weights)

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return Y theta, shape (N, n), for any theta (10 n), physical or not."""
        dynamics = self._recursion
        return dynamics.torque(_floats(q), _floats(dq), _floats(ddq), dynamics.layout.filled(theta))

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n) and the torque (N, n) without acceleration, for any theta (10 n)."""
        dynamics = self._recursion
        return dynamics.mass_and_bias(_floats(q), _floats(dq), dynamics.layout.filled(theta))

    def placements(self, q: Array) -> Placements:
        """Return where the bodies ``arm.bodies`` are at positions q (N, n), in the frame of the root link."""
        return placements(self._recursion.tree, self._arm.bodies[0].placement[:3, 3], _floats(q))

    def with_gravity(self, gravity: tuple[float, ...]) -> RigidBodies:
        """Return the bodies under another gravity (3), m/s^2."""
        x, y, z = gravity
        return replace(self, gravity=(x, y, z))

    def with_displacement(self, joint: str, by: tuple[float, ...]) -> RigidBodies:
        """Return the bodies with a joint displaced further by (9): x, y, z (m) of its origin along the axes of its
        parent link's frame, then rotation vectors (rad) in its own frame, of the frame with all that it carries and of
        the axis alone.
        """
        known = dict(self.displacements)
        moved = np.add(known.get(joint, np.zeros(9)), by).tolist()
        return replace(self, displacements=tuple((known | {joint: tuple(moved)}).items()))

    def _nominal(self, key: str) -> dict[str, float]:
        return {joint.name: joint.nominal[key] for joint in self._driven if key in joint.nominal}

    @cached_property
    def _file(self) -> RobotFile:
        return _parsed(self.xml, self.source)

    @cached_property
    def _assembled(self) -> Arm:
        """The bodies before they are displaced."""
        return _assembled(self.xml, self.source, self.joints_used, tuple(self.locked))

    @cached_property
    def _arm(self) -> Arm:
        return displaced(self._assembled, dict(self.displacements)) if self.displacements else self._assembled

    @cached_property
    def _recursion(self) -> Recursion:
        layout = _layout(self._assembled)  # displaced joints do not change it
        tree = Tree.of(self._arm, layout) if self.displacements else _tree(self._arm, layout)
        return recursion(tree, np.array(self.gravity))

    @property
    def _driven(self) -> list[RobotJoint]:
        """The joints, in the chosen order."""
        return [self._arm.bodies[k].joint for k in self._arm.driven]


def read_robot_file(xml: str, source: str) -> RobotFile:
    """Parse the text of a URDF or MJCF file; ModelError where it is neither, or contradicts itself."""
    root = parse(xml, source)
    if root.tag not in READERS:
        raise ModelError(
            f"{source}: the root element is <{root.tag}>; a URDF begins with <robot>, an MJCF with <mujoco>."
            f"{SDF if root.tag == 'sdf' else ''}"
        )
    return READERS[root.tag](root, source)


@lru_cache(maxsize=8)
def _parsed(xml: str, source: str) -> RobotFile:
    """Return the file as parsed; kept, because bodies that are displaced or turned have the same text."""
    return read_robot_file(xml, source)


@lru_cache(maxsize=8)
def _assembled(xml: str, source: str, used: tuple[str, ...] | None, locked: tuple[tuple[str, float], ...]) -> Arm:
    """Return the bodies of a file before they are displaced; kept, as the file is."""
    return assemble(_parsed(xml, source), used, dict(locked))


@lru_cache(maxsize=8)
def _layout(arm: Arm) -> Layout:
    return Layout.of(arm)


@lru_cache(maxsize=8)
def _tree(arm: Arm, layout: Layout) -> Tree:
    """Return the tree of an arm; kept, because bodies under another gravity have the same."""
    return Tree.of(arm, layout)


@lru_cache(maxsize=8)
def _parameters(arm: Arm) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"{body.name}.{role}", unit, f"{meaning} of {body.name}", value, role, body.name)
        for body in arm.chosen
        for role, unit, meaning, value in zip(INERTIAL, UNITS, MEANINGS, _values(body), strict=True)
    )


def _values(body: ArmBody) -> list[float | None]:
    return [None] * 10 if np.isnan(body.theta).any() else body.theta.tolist()


def _floats(states: Array) -> Array:
    return np.ascontiguousarray(states, dtype=float)
