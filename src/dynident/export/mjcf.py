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
        for node in (one for one in _nodes(text) if one.tag == "body"):
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
    joints = {joint.name for joint in bodies.joints}
    for node in _nodes(text):
        name = node.attributes.get("name", "")
        if node.tag == "body" and name in shares.links:
            _set_inertia(text, node, shares.links[name], bodies.file.origins[name])
        elif node.tag == "joint" and name in joints:
            _set_drive(text, node, found, name)


def _set_inertia(text: Text, body: Node, theta: Array | None, origin: Array) -> None:
    element = NOTHING
    if theta is not None:
        mass, centre, tensor = to_physical(theta, body.attributes["name"])
        full = numbers_text(tensor[place] for place in FULL)
        element = f'<inertial pos="{numbers_text(origin + centre)}" mass="{float(mass)!r}" fullinertia="{full}"/>'
    inertial = body.find("inertial")
    if inertial is None:
        text.insert(body, element)
    else:
        text.replace(inertial, element)


def _set_drive(text: Text, joint: Node, found: Drives, name: str) -> None:
    names = {"armature": found.armature, "damping": found.damping, "frictionloss": found.friction}
    text.set(joint, {key: repr(float(values[name])) for key, values in names.items() if name in values})


def _set_gravity(text: Text, gravity: tuple[float, ...]) -> None:
    """Set gravity wherever it is given, as the last one counts; else in the first option, or in a new one."""
    options = [child for child in text.root.children if child.tag == "option"]
    stated = [option for option in options if "gravity" in option.attributes] or options[:1]
    for option in stated:
        text.set(option, {"gravity": numbers_text(gravity)})
    if not stated:
        text.insert(text.root, f'<option gravity="{numbers_text(gravity)}"/>')


def _freed(text: Text) -> tuple[str, ...]:
    """Remove settings that would change the inertias when the file is compiled, and return a note on them."""
    gone: list[str] = []
    for compiler in (child for child in text.root.children if child.tag == "compiler"):
        keys = [key for key in ALTERING if key in compiler.attributes]
        keys += ["inertiafromgeom"] if compiler.attributes.get("inertiafromgeom") == "true" else []
        text.drop(compiler, tuple(keys))
        gone += keys
    return (f"<compiler> {', '.join(gone)} removed, so that the inertias are used as written",) if gone else ()
