"""Reads a URDF: links, joints, inertias, limits and nominal friction; shapes and all else are ignored.

Reference: the URDF specification of ROS, http://wiki.ros.org/urdf/XML. An inertia is given about the link's centre of
mass, in a frame that may be rotated against the link's.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np

from dynident.models.inertia import from_physical
from dynident.models.robot_files.xml import (
    LinkShapes,
    RobotFile,
    RobotJoint,
    RobotJointLimits,
    Shape,
    ShapeKind,
    angles,
    check_known,
    check_unique,
    note_exact_angles,
    numbers,
    placement,
    rotation,
    unit_vector,
)
from dynident.runtime import ModelError, choices
from dynident.runtime.arrays import Array

JointKind = Literal["fixed", "revolute", "prismatic"]
WORLD = "world"
KINDS: dict[str, JointKind] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
    "floating": "fixed",
    "planar": "fixed",
}
FREE = ("floating", "planar")
TENSOR = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))


def read_urdf(root: Element, source: str) -> RobotFile:
    """Parse the <robot> element.

    Raises ModelError where links and joints do not form one tree, a name is unknown, missing or duplicate, or an
    attribute is invalid.
    """
    links, joints = root.findall("link"), root.findall("joint")
    check_unique((link.get("name", "") for link in links), "link", source)
    check_unique((joint.get("name", "") for joint in joints), "joint", source)
    inertias = {link.get("name", ""): _inertia(link, source) for link in links}
    # some exporters do not declare the world link that the base is fixed to
    if any(parent.get("link") == WORLD for parent in root.findall("joint/parent")):
        inertias.setdefault(WORLD, np.zeros(10))
    robot_joints = _check_mimics(tuple(_joint(joint, inertias, source) for joint in joints))
    root_link = _root(robot_joints, list(inertias), source)
    return RobotFile("urdf", source, root_link, inertias, robot_joints, notes=_note_exact_angles(joints))


def _check_mimics(joints: tuple[RobotJoint, ...]) -> tuple[RobotJoint, ...]:
    """Refuse the use of a joint that mimics one that is not in the file; fixed joints follow nothing."""
    names, out = {joint.name: None for joint in joints}, []
    for joint in joints:
        master = joint.follows[0] if joint.follows else ""
        if joint.kind == "fixed":
            joint = replace(joint, follows=None)
        elif joint.follows and master not in names:
            reason = f"it mimics {master!r}, and the file has no joint {master!r}: {choices(master, names)}"
            joint = replace(joint, follows=None, refusal=reason.rstrip("."))
        out.append(joint)
    return tuple(out)


def _note_exact_angles(joints: Sequence[Element]) -> tuple[str, ...]:
    """Return a note on the angles that are read as exact ones."""
    origins = ((repr(joint.get("name")), joint.find("origin")) for joint in joints)
    return note_exact_angles("rpy", ((name, origin.get("rpy", "")) for name, origin in origins if origin is not None))


def _root(joints: Sequence[RobotJoint], links: list[str], source: str) -> str:
    """Return the one link without a parent, from which all others must be reached."""
    parents: dict[str, RobotJoint] = {}
    for joint in joints:
        if joint.child in parents:
            raise ModelError(
                f"{source}: link {joint.child!r} has two parents, by the joints {parents[joint.child].name!r} and "
                f"{joint.name!r}: a closed loop. Only trees can be identified; cut the loop at one of them."
            )
        parents[joint.child] = joint
    roots = [link for link in links if link not in parents]
    if len(roots) > 1:
        raise ModelError(
            f"{source}: {len(roots)} links have no parent ({', '.join(map(repr, roots[:5]))}); the file must describe "
            "one tree: connect the others by joints (fixed ones perhaps), or delete them."
        )
    # a tree has one root, and no cycle: links of a cycle have parents, but cannot be reached from the root
    acyclic: set[str] = set()
    for link in links:
        _check_cycle(link, parents, acyclic, source)
    if not roots:
        raise ModelError(f"{source}: the file has no <link>.")
    return roots[0]


def _check_cycle(link: str, parents: Mapping[str, RobotJoint], acyclic: set[str], source: str) -> None:
    """Raise ModelError for a cycle of the links above this one; else add them to ``acyclic``, not to be seen again."""
    above: dict[str, None] = {}
    while link in parents and link not in above and link not in acyclic:
        above[link] = None
        link = parents[link].parent
    if link in above:
        links = list(above)
        loop = " -> ".join([*links[links.index(link) :], link][::-1])
        raise ModelError(f"{source}: the links {loop} form a cycle; only trees can be identified.")
    acyclic.update(above)


def origin(element: Element | None, where: str) -> tuple[Array, Array]:
    """Return rotation (3, 3) and translation (3) of an <origin>: roll, pitch, yaw about fixed axes."""
    x, y, z = np.eye(3)
    roll, pitch, yaw = angles(element, "rpy", "0 0 0", where, 3)
    return rotation(z, yaw) @ rotation(y, pitch) @ rotation(x, roll), numbers(element, "xyz", "0 0 0", where, 3)


def _inertia(link: Element, source: str) -> Array:
    """Return the parameters (10) in the link's frame; a link without <inertial> has no mass, by the specification."""
    inertial, where = link.find("inertial"), f"{source}, <inertial> of link {link.get('name')!r}"
    if inertial is None:
        return np.zeros(10)
    mass, tensor = inertial.find("mass"), inertial.find("inertia")
    if mass is None or tensor is None:
        raise ModelError(f"{where}: it needs both <mass> and <inertia>.")
    values = {key: numbers(tensor, key, "", where)[0] for row in TENSOR for key in row}
    turn, centre = origin(inertial.find("origin"), where)
    about_centre = turn @ np.array([[values[key] for key in row] for row in TENSOR]) @ turn.T
    return from_physical(numbers(mass, "value", "", where)[0], centre, (about_centre + about_centre.T) / 2)


def _joint(element: Element, links: Collection[str], source: str) -> RobotJoint:
    name, type_ = element.get("name", ""), element.get("type", "")
    where = f"{source}, joint {name!r}"
    if type_ not in KINDS:
        raise ModelError(f"{where}: type {type_!r}; {choices(type_, KINDS)}")
    ends = {tag: _end(element, tag, links, where) for tag in ("parent", "child")}
    # some exporters write a zero axis for fixed joints
    axis = np.eye(3)[0]
    if KINDS[type_] != "fixed":
        axis = unit_vector(numbers(element.find("axis"), "xyz", "1 0 0", where, 3), where)
    return RobotJoint(
        name=name,
        kind=KINDS[type_],
        **ends,
        placement=placement(*origin(element.find("origin"), where)),
        axis=axis,
        limits=_limits(element.find("limit"), type_, where),
        nominal=_nominal(element.find("dynamics"), where),
        follows=_follows(element.find("mimic"), where),
        refusal=f"it is a {type_} joint, which has several coordinates" if type_ in FREE else "",
        free=type_ in FREE,
    )


def _nominal(dynamics: Element | None, where: str) -> dict[str, float]:
    keys = [key for key in ("damping", "friction") if dynamics is not None and key in dynamics.attrib]
    return {key: float(numbers(dynamics, key, "0", where)[0]) for key in keys}


def _follows(mimic: Element | None, where: str) -> tuple[str, float, float] | None:
    """Return the joint that is mimicked, the multiplier and the offset."""
    if mimic is None:
        return None
    multiplier, offset = (numbers(mimic, key, x, where)[0] for key, x in (("multiplier", "1"), ("offset", "0")))
    return mimic.get("joint", ""), float(multiplier), float(offset)


def _end(joint: Element, tag: str, links: Collection[str], where: str) -> str:
    element = joint.find(tag)
    if element is None or not element.get("link"):
        raise ModelError(f"{where}: it has no <{tag} link=...>.")
    link = element.get("link", "")
    check_known(link, links, f"{where}, <{tag}>", "link")
    return link


def _limits(limit: Element | None, type_: str, where: str) -> RobotJointLimits:
    """Return the limits; infinite ones are None, as are those of position for a continuous joint."""
    keys = ["effort", "velocity"] + (["lower", "upper"] if type_ in ("revolute", "prismatic") else [])
    values: dict[str, float] = {}
    for key in keys if limit is not None else []:
        text = (limit.get(key) or "inf").strip() if limit is not None else "inf"
        if text.lstrip("+-").lower() not in ("inf", "infinity"):
            values[key] = float(numbers({key: text}, key, "", where)[0])
    return RobotJointLimits(**values)


SHAPE_KINDS = {kind.value: kind for kind in ShapeKind if kind is not ShapeKind.ELLIPSOID}


def urdf_shapes(root: Element, source: str) -> dict[str, LinkShapes]:
    """Return the shapes of each link of a <robot> element; ModelError for a shape without a size."""
    return {
        link.get("name", ""): LinkShapes(*(tuple(_shapes(link, tag, source)) for tag in ("collision", "visual")))
        for link in root.findall("link")
    }


def _shapes(link: Element, tag: str, source: str) -> Iterator[Shape]:
    where = f"{source}, <{tag}> of link {link.get('name')!r}"
    for element in link.findall(tag):
        for geometry in element.findall("geometry/*"):
            if geometry.tag in SHAPE_KINDS:
                size = _size(geometry, where)
                if geometry.tag != "mesh" and min(size) <= 0:
                    raise ModelError(f"{where}: a {geometry.tag} of the size {size}; give lengths above zero.")
                frame = placement(*origin(element.find("origin"), where))
                yield Shape(SHAPE_KINDS[geometry.tag], size, frame, geometry.get("filename", ""))


def _size(geometry: Element, where: str) -> tuple[float, ...]:
    if geometry.tag == "mesh":
        return tuple(numbers(geometry, "scale", "1 1 1", where, 3).tolist())
    if geometry.tag == "box":
        return tuple((numbers(geometry, "size", "", where, 3) / 2).tolist())
    radius = float(numbers(geometry, "radius", "", where)[0])
    return (radius,) if geometry.tag == "sphere" else (radius, float(numbers(geometry, "length", "", where)[0]) / 2)
