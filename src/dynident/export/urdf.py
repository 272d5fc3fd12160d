"""The identified model as a URDF: the original text, with the identified inertias and joint friction."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.export.edit import Node, Text
from dynident.export.identified import Drives, Identified, Shares, drives, link_inertias
from dynident.export.placement import moves, placed
from dynident.export.written import Written
from dynident.models import RigidBodies, to_physical

__all__ = ["identified_urdf", "joints_alone", "numbers_text", "relocated"]

Array = NDArray[np.float64]
EARTH = (0.0, 0.0, -9.81)
FILES = {"mesh": ("filename",), "texture": ("filename",), "compiler": ("meshdir", "texturedir", "assetdir")}
TENSOR = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def identified_urdf(identified: Identified) -> Written:
    """Return the robot's URDF with ``<inertial>`` and ``<dynamics>`` as identified; all else is preserved byte by byte.

    Rotor inertia that acts on the torque as a link's inertia does is written as such (``placed``). An exception from
    the bytes is rounded angles of joints: they are written exactly, as they were used, such as pi for 3.14159.

    Inertias are about the centre of mass with the axes of the link (the specification of ROS,
    http://wiki.ros.org/urdf/XML). Raises ModelError where the model does not come from a URDF, and for inconsistent
    bodies or negative friction.
    """
    bodies, _ = identified.bodies
    if bodies.format != "urdf":
        raise ModelError(f"{bodies.source}: it is an MJCF, which can be written as `mjcf`, not as `urdf`.")
    best = placed(identified, armature=False)
    found, shares = drives(best, armature=False), link_inertias(bodies, best.bodies[1])
    text = Text(bodies.xml)
    joints = {body.joint.name for body in bodies.arm.bodies}
    for node in text.root.children:
        name = node.attributes.get("name", "")
        if node.tag == "link" and name in shares.links:
            _set_inertia(text, node, shares.links[name])
        elif node.tag == "joint":
            _set_joint(text, node, found, name if name in joints else None)
    gravity = [] if bodies.gravity == EARTH else [f"gravity {bodies.gravity} m/s^2 in the frame of the root link"]
    notes = (*moves(identified, best), *found.notes, *shares.notes, *standing(bodies, shares))
    return Written(str(text), (*found.left_out, *gravity), notes)


def joints_alone(xml: str) -> str:
    """Return a URDF of links and joints alone, which other readers take where they refuse the file: without inertia and
    shapes, with limits at each joint, and rounded angles written as this package reads them, such as pi for 3.14159."""
    text = Text(xml)
    for node in text.root.children:
        if node.tag not in ("link", "joint"):
            text.delete(node)
        for child in node.children if node.tag == "link" else ():
            text.delete(child)
        if node.tag == "joint":
            _free_joint(text, node)
    return str(text)


def _free_joint(text: Text, joint: Node) -> None:
    """Leave of a joint what places it and what it follows, and insert limits."""
    for child in joint.children:
        if child.tag == "origin":
            text.write_exact_angles(child, "rpy")
        elif child.tag not in ("parent", "child", "axis", "mimic"):
            text.delete(child)
    text.insert(joint, '<limit effort="1" velocity="1" lower="-1" upper="1"/>')


def relocated(xml: str, way: str) -> str:
    """Return a URDF for another folder, from which ``way`` leads to the one that its relative file names start at.

    These are those of meshes and textures, and the folders that MuJoCo's <compiler> names; URIs are left as they are.
    """
    text = Text(xml)
    for node in text.root.walk():
        keys = FILES.get(node.tag, ())
        names = {key: node.attributes[key] for key in keys if node.attributes.get(key)}
        moved = {key: f"{way}/{name}" for key, name in names.items() if not (":" in name or name.startswith("/"))}
        if moved:
            text.set(node, moved)
    return str(text)


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers with all their digits, separated by spaces."""
    return " ".join(repr(float(value)) for value in values)


def standing(bodies: RigidBodies, shares: Shares) -> tuple[str, ...]:
    """Return notes on the links that belong to a body only while a joint is fixed, and on their inertia."""
    movable = {joint.child: joint.name for joint in bodies.file.joints if joint.kind != "fixed"}
    names = [
        f"{movable[link]!r}" for body in bodies.arm.chosen for link in body.links[1:] if link in movable
    ]  # fmt: skip
    if not names:
        return ()
    sentence = (
        f"the joints {', '.join(names)} were fixed: the identified bodies include the links beyond them, which is "
        "exact "
        f"only in that position; these links have inertias {'as noted' if shares.notes else 'as the file has them'}"
    )
    return (sentence,)


def _set_inertia(text: Text, link: Node, theta: Array | None) -> None:
    inertial = link.find("inertial")
    if theta is None:
        if inertial is not None:
            text.delete(inertial)
        return
    mass, centre, tensor = to_physical(theta, link.attributes["name"])
    values = {key: repr(float(tensor[place])) for key, place in TENSOR.items()}
    if inertial is None:
        parts = (
            f'<origin xyz="{numbers_text(centre)}"/>',
            f'<mass value="{float(mass)!r}"/>',
            _element("inertia", values),
        )
        text.insert(link, "<inertial>", *("  " + part for part in parts), "</inertial>")
        return
    _set_origin(text, inertial, numbers_text(centre))
    for tag, attributes in (("mass", {"value": repr(float(mass))}), ("inertia", values)):
        element = inertial.find(tag)
        if element is not None:  # the parser rejects an <inertial> without them
            text.set(element, attributes)


def _set_origin(text: Text, inertial: Node, centre: str) -> None:
    """Set the frame of an inertia: at the centre of mass, with the axes of the link."""
    origin = inertial.find("origin")
    if origin is None:
        text.insert(inertial, f'<origin xyz="{centre}"/>')
    else:
        turned = {"rpy": "0 0 0"} if any(float(x) for x in origin.attributes.get("rpy", "").split()) else {}
        text.set(origin, {"xyz": centre, **turned})


def _element(tag: str, values: Mapping[str, str]) -> str:
    return f"<{tag} " + " ".join(f'{key}="{value}"' for key, value in values.items()) + "/>"


def _set_joint(text: Text, joint: Node, found: Drives, name: str | None) -> None:
    """Set the frame of a joint, and of one that moves, by its ``name``, the damping and friction."""
    if (origin := joint.find("origin")) is not None:
        text.write_exact_angles(origin, "rpy")
    if name is not None:
        _set_dynamics(text, joint, found, name)


def _set_dynamics(text: Text, joint: Node, found: Drives, name: str) -> None:
    given = {"damping": found.damping.get(name), "friction": found.friction.get(name)}
    values = {key: repr(float(value)) for key, value in given.items() if value is not None}
    dynamics = joint.find("dynamics")
    if dynamics is not None:
        text.set(dynamics, values)
    elif values:
        text.insert(joint, _element("dynamics", values))
