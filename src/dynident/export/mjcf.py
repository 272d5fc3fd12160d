"""The identified model as an MJCF: the original text, with the identified inertias, friction and rotor inertias.

Reference: the XML reference of MuJoCo, https://mujoco.readthedocs.io/en/stable/XMLreference.html.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.export.edit import Node, Text
from dynident.export.identified import Drives, Identified, Shares, drives, link_inertias
from dynident.export.placement import moves, placed
from dynident.export.urdf import numbers_text, standing
from dynident.export.written import Written
from dynident.models import RigidBodies, to_physical
from dynident.models.robot_file import UNNAMED

__all__ = ["identified_mjcf"]

Array = NDArray[np.float64]
ALTERING = ("balanceinertia", "boundmass", "boundinertia", "settotalmass")  # compiler settings that change inertias
FULL = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
NOTHING = '<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>'


def identified_mjcf(identified: Identified) -> Written:
    """Return the robot's MJCF with ``<inertial>``, ``armature``, ``damping`` and ``frictionloss`` as identified, the
    gravity of the identification, rounded angles as they were read, and without the compiler settings that would
    change inertias.

    Raises ModelError where the model does not come from an MJCF, and for inconsistent bodies or negative friction.
    """
    bodies, _ = identified.bodies
    if bodies.format != "mjcf":
        raise ModelError(f"{bodies.source}: it is a URDF, which can be written as `urdf`, not as `mjcf`.")
    best = placed(identified, armature=True)
    found, shares = drives(best, armature=True), link_inertias(bodies, best.bodies[1])
    text = Text(bodies.xml)
    if _in_radians(text):
        for node in (one for one in _nodes(text) if one.tag in ("body", "frame")):
            text.write_exact_angles(node, "euler")
            text.write_exact_angles(node, "axisangle", 1)
    _set_found(text, bodies, found, shares)
    if bodies.file.gravity != bodies.gravity:
        _set_gravity(text, bodies.gravity)
    notes = (*moves(identified, best), *found.notes, *shares.notes, *standing(bodies, shares), *_freed(text))
    return Written(str(text), found.left_out, notes)


def _in_radians(text: Text) -> bool:
    compilers = [child.attributes for child in text.root.children if child.tag == "compiler"]
    return [one["angle"] for one in compilers if "angle" in one][-1:] == ["radian"]


def _nodes(text: Text) -> Iterator[Node]:
    """Yield all elements of the bodies."""
    for world in text.root.children:
        if world.tag == "worldbody":
            yield from world.walk()


def _set_found(text: Text, bodies: RigidBodies, found: Drives, shares: Shares) -> None:
    """Set the inertias of bodies, and what drives their joints."""
    joints = {body.joint.name for body in bodies.arm.bodies}
    links = {name: theta for name, theta in bodies.file.links.items() if theta is not None}
    altered, count = bool(_altering(text)), 0
    for node in _nodes(text):
        count += node.tag == "body"
        name = node.attributes.get("name") or (UNNAMED.format(count) if node.tag == "body" else "")
        if node.tag == "body" and name in shares.links:
            _set_inertia(text, node, name, shares.links[name], bodies.file.origins[name])
        elif node.tag == "body" and name in links and (altered or node.find("inertial") is None):
            # of shapes, or as the compiler alters it; without its settings and without shapes it is the same
            _set_inertia(text, node, name, links[name], bodies.file.origins[name])
        elif node.tag == "joint" and name in joints:
            _set_drive(text, node, found, name)


def _set_inertia(text: Text, body: Node, name: str, theta: Array | None, origin: Array) -> None:
    element = NOTHING
    if theta is not None and theta.any():
        mass, centre, tensor = to_physical(theta, name)
        full = numbers_text(tensor[place] for place in FULL)
        element = f'<inertial pos="{numbers_text(origin + centre)}" mass="{float(mass)!r}" fullinertia="{full}"/>'
    inertial = body.find("inertial")
    if inertial is None:
        text.insert(body, element)
    else:
        text.replace(inertial, element)


def _set_drive(text: Text, joint: Node, found: Drives, name: str) -> None:
    names = {"armature": found.armature, "damping": found.damping, "frictionloss": found.friction}
    given = {key: repr(float(values[name])) for key, values in names.items() if name in values}
    if "damping" in given and any(" " in node.attributes.get("damping", "").strip() for node in text.root.walk()):
        given["damping"] += " 0 0"  # a default class has powers, which would be added
    text.set(joint, given)


def _set_gravity(text: Text, gravity: tuple[float, ...]) -> None:
    """Set gravity wherever it is given, as the last one counts; else in the first option, or in a new one."""
    options = [child for child in text.root.children if child.tag == "option"]
    stated = [option for option in options if "gravity" in option.attributes] or options[:1]
    for option in stated:
        text.set(option, {"gravity": numbers_text(gravity)})
    if not stated:
        text.insert(text.root, f'<option gravity="{numbers_text(gravity)}"/>')


def _altering(text: Text) -> list[tuple[Node, tuple[str, ...]]]:
    """Return the compiler settings that change inertias, by their element."""
    found = []
    for compiler in (child for child in text.root.children if child.tag == "compiler"):
        keys = [key for key in ALTERING if key in compiler.attributes]
        keys += ["inertiafromgeom"] if compiler.attributes.get("inertiafromgeom") == "true" else []
        found += [(compiler, tuple(keys))] if keys else []
    return found


def _freed(text: Text) -> tuple[str, ...]:
    """Remove settings that would change the inertias when the file is compiled, and return a note on them."""
    gone = [key for _, keys in _altering(text) for key in keys]
    for compiler, keys in _altering(text):
        text.drop(compiler, keys)
    return (f"<compiler> {', '.join(gone)} removed, so that the inertias are used as written",) if gone else ()
