"""Reads a MuJoCo model (MJCF): bodies, joints, inertias, limits and nominal friction.

Reference: the XML reference of MuJoCo, https://mujoco.readthedocs.io/en/stable/XMLreference.html. A body's frame here
is at the anchor of its last joint, with the body's axes; of several joints, each but the last moves a massless link.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from dynident.models.inertia import change_frame
from dynident.models.robot_files.mjcf_defaults import (
    ANGULAR,
    Attributes,
    Defaults,
    add_followers,
    merge_attributes,
    note_ignored_forces,
    read_constraints,
    read_defaults,
)
from dynident.models.robot_files.mjcf_inertia import SIZES, body_inertia, shape_size, with_total_mass
from dynident.models.robot_files.xml import (
    LinkShapes,
    RobotFile,
    RobotJoint,
    RobotJointLimits,
    Shape,
    ShapeKind,
    check_unique,
    motion_matrix,
    note_exact_angles,
    numbers,
    placement,
    unit_vector,
)
from dynident.runtime import ModelError, choices

Array = NDArray[np.float64]
WORLD = "world"
UNNAMED = "body {}"  # the name of a body that has none, by its place in the file
UNREAD = ("attach", "replicate", "composite", "flexcomp", "plugin")
KINDS: dict[str, Literal["fixed", "revolute", "prismatic"]] = {
    "hinge": "revolute",
    "slide": "prismatic",
    "ball": "fixed",
    "free": "fixed",
}
NOMINAL = {"damping": "damping", "friction": "frictionloss", "armature": "armature"}
SPRINGS = ("stiffness", "springdamper")


@dataclass(frozen=True, eq=False)
class _Reader:
    """Settings of the whole file, and what has been read so far."""

    defaults: Defaults
    links: dict[str, Array | None] = field(default_factory=dict)
    joints: list[RobotJoint] = field(default_factory=list)
    origins: dict[str, Array] = field(default_factory=dict)
    zeros: dict[str, float] = field(default_factory=dict)

    @property
    def source(self) -> str:
        return self.defaults.source

    def bodies(self, element: Element, parent: str, above: Array, inherited: str, where: str) -> None:
        """Read the bodies of an element; ``above`` (4, 4) is the frame of that in the parent's link."""
        for child, child_class, frame in self.defaults.inside(element, inherited, where):
            if child.tag == "body":
                self.body(child, parent, above @ frame, child_class)

    def body(self, element: Element, parent: str, above: Array, inherited: str) -> None:
        """Read a body and those below it."""
        name = element.get("name", "")
        where = f"{self.source}, body {name!r}"
        inherited = element.get("childclass", inherited)
        frame = above @ self.defaults.frame(element.attrib, where)
        anchor = self._joints(element, parent, frame, inherited, where)
        theta = body_inertia(element, inherited, self.defaults, where)
        # frames of links are at the anchor of the last joint, so that the joint turns about their origin
        back = placement(np.eye(3), -anchor)
        self.links[name], self.origins[name] = None if theta is None else change_frame(theta, back), anchor
        self.bodies(element, name, back, inherited, where)

    def _joints(self, body: Element, parent: str, frame: Array, inherited: str, where: str) -> Array:
        """Read the joints of a body, and return the anchor (3) of the last one in the body's frame."""
        name, anchor = body.get("name", ""), np.zeros(3)
        joint_elements = [x for x in self.defaults.inside(body, inherited, where) if x[0].tag in ("joint", "freejoint")]
        for place, (element, class_name, inner) in enumerate(joint_elements, start=1):
            attributes = self.defaults.resolve(element, class_name)
            pos = (inner @ np.append(numbers(attributes, "pos", "0 0 0", where, 3), 1.0))[:3]
            last = place == len(joint_elements)
            link = name if last else f"{name} by {attributes.get('name', '')}"
            joint = self._joint(attributes, inner[:3, :3], name)
            joint_frame = frame @ placement(np.eye(3), pos - anchor)
            self._add(replace(joint, parent=parent, child=link, placement=joint_frame))
            # several joints of a body move one after the other: massless links connect them
            if not last:
                self.links[link], parent, frame = np.zeros(10), link, np.eye(4)
            anchor = pos
        if not joint_elements:
            fixed_joint = RobotJoint(f"{name} (fixed)", "fixed", parent, name, frame, np.array([0.0, 0.0, 1.0]))
            self.joints.append(fixed_joint)
        return anchor

    def _add(self, joint: RobotJoint) -> None:
        """Add a joint, whose frame in the file is at the position that the file shows."""
        self.joints.append(replace(joint, placement=joint.placement @ motion_matrix(joint, -self.zeros[joint.name])))

    def _joint(self, attributes: Attributes, turn: Array, body: str) -> RobotJoint:
        """Return a joint without its links and placement, and note its zero."""
        type_ = attributes.get("type", "hinge")
        free = KINDS.get(type_) == "fixed"
        name = attributes.get("name", "") or (f"{body} ({type_})" if free else "")
        where = f"{self.source}, joint {name!r} of body {body!r}"
        if not name:
            raise ModelError(f"{where}: it has no name; give it one, because data are matched by name.")
        if type_ not in KINDS:
            raise ModelError(f"{where}: type {type_!r}; {choices(type_, KINDS)}")
        # the compiler's unit of angles does not hold for lengths
        scale = np.pi / 180 if self.defaults.degrees and type_ == "hinge" else 1.0
        refusal = f"it is a {type_} joint, which has several coordinates" if free else ""
        if spring := [key for key in SPRINGS if _force_coefficients(attributes, key, where).any()]:
            refusal = f"it has a spring ({spring[0]} {attributes[spring[0]]}), which no term of the model describes"
        self.zeros[name] = scale * float(numbers(attributes, "ref", "0", where)[0])
        return RobotJoint(
            name=name,
            kind=KINDS[type_],
            parent="",
            child="",
            placement=np.eye(4),
            axis=turn @ unit_vector(numbers(attributes, "axis", "0 0 1", where, 3), where),
            limits=self._limits(attributes, scale, where),
            nominal={
                k: float(_force_coefficients(attributes, v, where)[0]) for k, v in NOMINAL.items() if v in attributes
            },
            refusal=refusal,
            free=free,
        )

    def _limits(self, attributes: Attributes, scale: float, where: str) -> RobotJointLimits:
        def pair(limited: str, key: str, scale: float) -> tuple[float | None, float | None]:
            """Return the limits of a key where its flag says that they act."""
            # by default (autolimits) a range alone makes a limit act
            automatic = self.defaults.compiler.get("autolimits", "true")
            active = attributes.get(limited, "auto").replace("auto", automatic)
            if active != "true" or key not in attributes:
                return None, None
            low, high = numbers(attributes, key, "", where, 2)
            return float(low * scale), float(high * scale)

        lower, upper = pair("limited", "range", scale)
        _, effort = pair("actuatorfrclimited", "actuatorfrcrange", 1.0)
        return RobotJointLimits(effort=effort, lower=lower, upper=upper)


def read_mjcf(root: Element, source: str) -> RobotFile:
    """Parse the <mujoco> element.

    Raises ModelError for elements that change the dynamics and are not supported, joints without a name, duplicate
    names, and invalid attributes.
    """
    defaults = read_defaults(root, source)
    _check_read(root, defaults)
    bodies = named_bodies(root)
    check_unique([WORLD, *(body.get("name", "") for body in bodies)], "body", source)
    reader = _Reader(defaults, {WORLD: np.zeros(10)})
    for world in root.findall("worldbody"):
        reader.bodies(world, WORLD, np.eye(4), world.get("childclass", "main"), f"{source}, <worldbody>")
    check_unique((joint.name for joint in reader.joints), "joint", source)
    joints = add_followers(root, defaults, reader.joints, reader.zeros)
    massless = tuple(name for name in reader.links if name not in reader.origins and name != WORLD)
    return RobotFile(
        format="mjcf",
        source=source,
        root=WORLD,
        links=with_total_mass(reader.links, defaults.compiler, f"{source}, <compiler>"),
        joints=joints,
        constraints=read_constraints(root, defaults),
        gravity=tuple(
            numbers(merge_attributes(root, "option"), "gravity", "0 0 -9.81", f"{source}, <option>", 3).tolist()
        ),
        notes=(*note_ignored_forces(root), *(() if defaults.degrees else _note_exact_angles(root))),
        origins=reader.origins,
        massless=massless,
    )


def named_bodies(root: Element) -> list[Element]:
    """Return all bodies, those without a name named by their place in the file; MuJoCo needs none."""
    bodies = [body for world in root.findall("worldbody") for body in world.iter("body")]
    for place, body in enumerate(bodies, start=1):
        if not body.get("name"):
            body.set("name", UNNAMED.format(place))
    return bodies


def _check_read(root: Element, defaults: Defaults) -> None:
    """Raise ModelError for elements that change the dynamics and are not supported."""
    source = defaults.source
    for element in (inner for world in root.findall("worldbody") for inner in world.iter()):
        if element.tag in UNREAD:
            raise ModelError(
                f"{source}: <{element.tag}> is not supported; save the compiled model from MuJoCo "
                "(mj_saveLastXML), which writes it out, and use that file."
            )
    if any(True for _ in root.iter("include")):
        raise ModelError(
            f"{source}: <include> names another file, and this text is read without files; give the path of the file "
            "(`dynident.read_robot`), or write the included elements out."
        )
    if defaults.compiler.get("coordinate") == "global":
        raise ModelError(f"{source}: coordinate='global' is not supported; save the file again with a current MuJoCo.")


def _force_coefficients(attributes: Attributes, key: str, where: str) -> Array:
    """Return the coefficients of a force that is linear, and of its square and cube where they are given."""
    return numbers(attributes, key, "0", where, len(attributes.get(key, "0").split()[:3]) or 1)


def _note_exact_angles(root: Element) -> tuple[str, ...]:
    """Return a note on the angles in rad that are replaced by exact ones."""
    return note_exact_angles("euler, axisangle", _angles(root))


def _angles(root: Element) -> Iterator[tuple[str, str]]:
    """Yield the name of a body and the angles of its own placement, or of a frame's."""
    angle_start = {"euler": -3, "axisangle": -1}  # which numbers are angles
    for element in (inner for world in root.findall("worldbody") for inner in world.iter()):
        for key in (
            attribute for attribute in ANGULAR if attribute in element.attrib and element.tag in ("body", "frame")
        ):
            yield repr(element.get("name", "")), " ".join(element.attrib[key].split()[angle_start[key] :])


PLACEMENT_KEYS = ("refpos", "refquat")  # of a mesh: not read


def mjcf_shapes(root: Element, source: str, origins: Mapping[str, Array]) -> dict[str, LinkShapes]:
    """Return the shapes of each body of a <mujoco> element, in the frames of the links (``RobotFile.origins``).

    Planes and height fields are left out. Raises ModelError for a shape with a wrong size.
    """
    defaults = read_defaults(root, source)
    named_bodies(root)
    meshes = {name: mesh for asset in root.findall("asset") for name, mesh in _meshes(asset, defaults)}
    link_shapes: dict[str, LinkShapes] = {}

    def read(element: Element, name: str, inherited: str) -> None:
        """Read the shapes of a body, and of those below it."""
        where = f"{source}, body {name!r}"
        shapes: tuple[list[Shape], list[Shape]] = ([], [])
        back = placement(np.eye(3), -origins.get(name, np.zeros(3)))
        for child, child_class, frame in defaults.inside(element, inherited, where):
            if child.tag == "geom":
                attributes = defaults.resolve(child, child_class)
                # shapes that collide with nothing are only shown
                is_visual = attributes.get("contype") == "0" and attributes.get("conaffinity") == "0"
                shapes[is_visual].extend(_shape(attributes, back @ frame, defaults, meshes, where))
            elif child.tag == "body":
                read(child, child.get("name", ""), child.get("childclass", child_class))
        earlier = link_shapes.get(name, LinkShapes())
        link_shapes[name] = LinkShapes((*earlier.collision, *shapes[0]), (*earlier.visual, *shapes[1]))

    for world in root.findall("worldbody"):
        read(world, WORLD, world.get("childclass", "main"))
    return link_shapes


def _shape(
    attributes: Attributes, above: Array, defaults: Defaults, meshes: Mapping[str, Attributes], where: str
) -> Iterator[Shape]:
    kind = attributes.get("type", "sphere")
    if kind in SIZES and "mesh" not in attributes:
        size, frame = shape_size(kind, attributes, defaults, f"{where}, <geom> {attributes.get('name', '')!r}")
        yield Shape(ShapeKind(kind), tuple(size), above @ frame)
    elif "mesh" in attributes:
        mesh = meshes.get(attributes["mesh"], {})
        # a mesh with a placement of its own would be drawn at a wrong place
        name = "" if any(key in mesh for key in PLACEMENT_KEYS) else _path(mesh, defaults)
        scale = tuple(numbers(mesh, "scale", "1 1 1", where, 3).tolist())
        yield Shape(ShapeKind.MESH, scale, above @ defaults.frame(attributes, where), name)


def _meshes(asset: Element, defaults: Defaults) -> Iterator[tuple[str, Attributes]]:
    for mesh in asset.findall("mesh"):
        attributes = defaults.resolve(mesh, "main")
        yield attributes.get("name") or PurePosixPath(attributes.get("file", "")).stem, attributes


def _path(mesh: Attributes, defaults: Defaults) -> str:
    """Return the name of a mesh's file from the folder of the model, empty where it has none."""
    compiler, name = defaults.compiler, mesh.get("file", "")
    if not name:
        return ""
    name = PurePosixPath(name).name if compiler.get("strippath") == "true" else name
    return str(PurePosixPath(compiler.get("meshdir", compiler.get("assetdir", ""))) / name)
