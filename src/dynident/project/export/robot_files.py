"""Robot files with identified values, and a payload as a link of its own, fixed to the link that carries it."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import chain, count

import numpy as np

from dynident.files.meshes import inertial_element, named_body_nodes
from dynident.files.xml_text import XmlNode, XmlText
from dynident.models import RigidBodies, to_physical
from dynident.project.export.identified import Drives, IdentifiedModel, LinkInertias, drives, link_inertias
from dynident.project.export.servos import actuator_lines, range_lines, ranges
from dynident.project.export.tree_text import element, mesh_notes, mjcf_of, numbers_text, urdf_of
from dynident.project.export.written import ExportText, move_notes, place_values
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array

EARTH_GRAVITY = (0.0, 0.0, -9.81)
FILE_ATTRIBUTES = {"mesh": ("filename",), "texture": ("filename",), "compiler": ("meshdir", "texturedir", "assetdir")}
TENSOR_ENTRIES = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
# compiler settings that change inertias
ALTERING_SETTINGS = "balanceinertia", "boundmass", "boundinertia", "settotalmass"
ZERO_INERTIAL = '<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>'

LINK_NAME = "payload"
MAX_TORQUE_DIFFERENCE = 1e-6  # largest difference of the torque, relative


def identified_urdf(identified: IdentifiedModel) -> ExportText:
    """Return the robot's URDF with ``<inertial>`` and ``<dynamics>`` as identified.

    All else is preserved byte by byte, except rounded angles of joints: they are written exactly, as they were
    used, such as pi for 3.14159. Rotor inertia that acts on the torque as the inertia of a link does is written
    as such (``place_values``).

    Inertias are about the centre of mass with the axes of the link (the specification of ROS,
    http://wiki.ros.org/urdf/XML). Raises ModelError where the model does not come from a URDF, and for
    inconsistent bodies or negative friction.
    """
    bodies, _ = identified.bodies
    text, joint_drives, notes = edit_urdf(identified, armature=False)
    gravity = [f"gravity {bodies.gravity} m/s^2 in the frame of the root link"] * (bodies.gravity != EARTH_GRAVITY)
    return ExportText(str(text), (*joint_drives.left_out, *gravity), notes)


def edit_urdf(identified: IdentifiedModel, *, armature: bool) -> tuple[XmlText, Drives, tuple[str, ...]]:
    """Return the URDF of the bodies, or that of their tree, with inertias, damping and friction, all that joints have
    of drives, and notes; ``armature``: whether rotor inertia is among that."""
    bodies, joint_drives, shares, notes = robot_content(identified, "urdf", armature=armature)
    is_converted = bodies.format != "urdf"
    text = XmlText(urdf_of(bodies) if is_converted else bodies.xml)
    joints = {body.joint.name for body in bodies.arm.bodies}
    # a tree has no inertias yet: those that stay as they are have to be set, too
    kept = {link: theta for link, theta in bodies.file.links.items() if theta is not None and theta[0] > 0}
    inertias = {**(kept if is_converted else {}), **shares.links}
    for node in text.root.children:
        name = node.attributes.get("name", "")
        if node.tag == "link" and name in inertias:
            _set_urdf_inertia(text, node, inertias[name])
        elif node.tag == "joint":
            if (origin := node.find("origin")) is not None:
                text.write_exact_angles(origin, "rpy")
            if name in joints:  # it moves
                _set_dynamics(text, node, joint_drives, name)
    return text, joint_drives, notes


def has_actuators(file_format: str, bodies: RigidBodies) -> bool:
    """Return whether a file of this format gets actuators: an MJCF does that is not the robot's own."""
    return file_format == "mjcf" != bodies.format


def robot_content(
    identified: IdentifiedModel, file_format: str, *, armature: bool
) -> tuple[RigidBodies, Drives, LinkInertias, tuple[str, ...]]:
    """Return the bodies of a robot file, what it gets of drives and links, and notes on them and the format."""
    bodies, _ = identified.bodies
    best = place_values(identified, armature=armature)
    # constant torques are part of actuators
    joint_drives = drives(best, armature=armature, offset=has_actuators(file_format, bodies))
    shares = link_inertias(bodies, best.bodies[1])
    notes = (*move_notes(identified, best), *joint_drives.notes, *shares.notes, *fixed_joint_notes(bodies, shares))
    if bodies.format != file_format:
        notes += mesh_notes(bodies)
    return bodies, joint_drives, shares, notes


def strip_to_joints(xml: str) -> str:
    """Return a URDF of links and joints alone, for readers that refuse the full file.

    It has no inertia and shapes, limits at each joint, and rounded angles written as this package reads them,
    such as pi for 3.14159.
    """
    text = XmlText(xml)
    for node in text.root.children:
        if node.tag not in ("link", "joint"):
            text.delete(node)
        for child in node.children if node.tag == "link" else ():
            text.delete(child)
        if node.tag == "joint":
            _free_joint(text, node)
    return str(text)


def _free_joint(text: XmlText, joint: XmlNode) -> None:
    """Keep only what places a joint and what it follows, and insert limits."""
    for child in joint.children:
        if child.tag == "origin":
            text.write_exact_angles(child, "rpy")
        elif child.tag not in ("parent", "child", "axis", "mimic"):
            text.delete(child)
    text.insert(joint, '<limit effort="1" velocity="1" lower="-1" upper="1"/>')


def relocate_files(xml: str, prefix: str) -> str:
    """Return a URDF for another folder, with ``prefix`` before its relative file names.

    ``prefix`` leads from that folder to the one where the names start. It is set for meshes and textures, and for
    the folders that MuJoCo's <compiler> names; URIs are left as they are.
    """
    text = XmlText(xml)
    for node in text.root.walk():
        keys = FILE_ATTRIBUTES.get(node.tag, ())
        names = {key: node.attributes[key] for key in keys if node.attributes.get(key)}
        # absolute names and URIs do not depend on the folder
        new_names = {
            key: f"{prefix}/{name}" for key, name in names.items() if not (":" in name or name.startswith("/"))
        }
        if new_names:
            text.set(node, new_names)
    return str(text)


def fixed_joint_notes(bodies: RigidBodies, shares: LinkInertias) -> tuple[str, ...]:
    """Return notes on the links that belong to a body only while a joint is fixed, and on their inertia."""
    movable = {joint.child: joint.name for joint in bodies.file.joints if joint.kind != "fixed"}
    names = [
        f"{movable[link]!r}" for body in bodies.arm.bodies_with_parameters for link in body.links[1:] if link in movable
    ]  # fmt: skip
    if not names:
        return ()
    inertias = "as noted" if shares.notes else "as the file has them"
    sentence = (
        f"the joints {', '.join(names)} were fixed: the identified bodies include the links beyond them, which is "
        f"exact only in that position; these links have inertias {inertias}"
    )
    return (sentence,)


def _set_urdf_inertia(text: XmlText, link: XmlNode, theta: Array | None) -> None:
    inertial = link.find("inertial")
    if theta is None:
        if inertial is not None:
            text.delete(inertial)
        return
    mass, centre, tensor = to_physical(theta, link.attributes["name"])
    if inertial is None:
        text.insert(link, *_inertial_lines(mass, centre, tensor))
        return
    # the tensor is written in the axes of the link: a rotated inertial frame is turned back
    _set_origin(text, inertial, numbers_text(centre))
    for tag, attributes in (("mass", {"value": repr(float(mass))}), ("inertia", _tensor_attributes(tensor))):
        if (node := inertial.find(tag)) is not None:  # the parser rejects an <inertial> without them
            text.set(node, attributes)


def _tensor_attributes(tensor: Array) -> dict[str, str]:
    return {key: repr(float(tensor[place])) for key, place in TENSOR_ENTRIES.items()}


def _inertial_lines(mass: float | Array, centre: Array, tensor: Array) -> tuple[str, ...]:
    return (
        "<inertial>",
        f"  {element('origin', xyz=centre)}",
        f"  {element('mass', value=mass)}",
        f"  {element('inertia', **_tensor_attributes(tensor))}",
        "</inertial>",
    )


def _set_origin(text: XmlText, inertial: XmlNode, centre: str) -> None:
    """Set the frame of an inertia: at the centre of mass, with the axes of the link."""
    origin = inertial.find("origin")
    if origin is None:
        text.insert(inertial, f'<origin xyz="{centre}"/>')
    else:
        rotation = {"rpy": "0 0 0"} if any(float(x) for x in origin.attributes.get("rpy", "").split()) else {}
        text.set(origin, {"xyz": centre, **rotation})


def _set_dynamics(text: XmlText, joint: XmlNode, joint_drives: Drives, name: str) -> None:
    coefficients = {"damping": joint_drives.damping.get(name), "friction": joint_drives.friction.get(name)}
    values = {key: repr(float(value)) for key, value in coefficients.items() if value is not None}
    dynamics = joint.find("dynamics")
    if dynamics is not None:
        text.set(dynamics, values)
    elif values:
        text.insert(joint, element("dynamics", **values))


def identified_mjcf(identified: IdentifiedModel) -> ExportText:
    """Return the robot's MJCF with the identified inertias, ``armature``, ``damping`` and ``frictionloss``.

    The gravity is that of the identification, rounded angles are written as they were read, and compiler settings
    that would change inertias are removed. Raises ModelError where the model does not come from an MJCF, and for
    inconsistent bodies or negative friction.
    """
    bodies, joint_drives, shares, notes = robot_content(identified, "mjcf", armature=True)
    text = XmlText(bodies.xml if bodies.format == "mjcf" else mjcf_of(bodies))
    compilers = [child.attributes for child in text.root.children if child.tag == "compiler"]
    # settings of several compiler elements are merged, the last one counts
    if [compiler["angle"] for compiler in compilers if "angle" in compiler][-1:] == ["radian"]:
        for node in (node for node in _body_nodes(text) if node.tag in ("body", "frame")):
            text.write_exact_angles(node, "euler")
            text.write_exact_angles(node, "axisangle", 1)
    _set_identified(text, bodies, joint_drives, shares)
    names = {node.attributes.get("name", "") for node in text.root.walk() if node.tag == "numeric"}
    lines = range_lines([x for x in ranges(identified, joint_drives) if x.label not in names])
    if has_actuators("mjcf", bodies):
        lines += actuator_lines(identified.servos, bodies, joint_drives.offset)
    if lines:
        text.insert(text.root, *lines)
    if bodies.file.gravity != bodies.gravity:
        _set_gravity(text, bodies.gravity)
    notes += _remove_altering(text)
    return ExportText(str(text), joint_drives.left_out, notes)


def _body_nodes(text: XmlText) -> Iterator[XmlNode]:
    """Yield all elements of the bodies."""
    for world in text.root.children:
        if world.tag == "worldbody":
            yield from world.walk()


def _set_identified(text: XmlText, bodies: RigidBodies, joint_drives: Drives, shares: LinkInertias) -> None:
    """Set the inertias of bodies, and the attributes of their joints."""
    joints = {body.joint.name for body in bodies.arm.bodies}
    links = {name: theta for name, theta in bodies.file.links.items() if theta is not None}
    altered = bool(_altering_settings(text))
    for name, node in named_body_nodes(text):
        # of shapes, or as the compiler alters it; without its settings and without shapes it is the same
        if name in shares.links or (name in links and (altered or node.find("inertial") is None)):
            theta, origin = {**links, **shares.links}[name], bodies.file.origins.get(name, np.zeros(3))
            _set_mjcf_inertia(text, node, name, theta, origin)
    for node in _body_nodes(text):
        if node.tag == "joint" and (name := node.attributes.get("name", "")) in joints:
            _set_drive(text, node, joint_drives, name)


def _set_mjcf_inertia(text: XmlText, body: XmlNode, name: str, theta: Array | None, origin: Array) -> None:
    line = inertial_element(theta, origin, name) if theta is not None and theta.any() else ZERO_INERTIAL
    inertial = body.find("inertial")
    if inertial is None:
        text.insert(body, line)
    else:
        text.replace(inertial, line)


def _set_drive(text: XmlText, joint: XmlNode, joint_drives: Drives, name: str) -> None:
    names = {"armature": joint_drives.armature, "damping": joint_drives.damping, "frictionloss": joint_drives.friction}
    attributes = {key: repr(float(values[name])) for key, values in names.items() if name in values}
    if "damping" in attributes and any(" " in node.attributes.get("damping", "").strip() for node in text.root.walk()):
        attributes["damping"] += " 0 0"  # a default class has powers, which would be added
    text.set(joint, attributes)


def _set_gravity(text: XmlText, gravity: tuple[float, ...]) -> None:
    """Set gravity wherever it is given, as the last one counts; else in the first option, or in a new one."""
    options = [child for child in text.root.children if child.tag == "option"]
    stated = [option for option in options if "gravity" in option.attributes] or options[:1]
    for option in stated:
        text.set(option, {"gravity": numbers_text(gravity)})
    if not stated:
        text.insert(text.root, f'<option gravity="{numbers_text(gravity)}"/>')


def _altering_settings(text: XmlText) -> list[tuple[XmlNode, tuple[str, ...]]]:
    """Return the compiler settings that change inertias, by their element."""
    settings = []
    for compiler in (child for child in text.root.children if child.tag == "compiler"):
        keys = [key for key in ALTERING_SETTINGS if key in compiler.attributes]
        keys += ["inertiafromgeom"] if compiler.attributes.get("inertiafromgeom") == "true" else []
        settings += [(compiler, tuple(keys))] if keys else []
    return settings


def _remove_altering(text: XmlText) -> tuple[str, ...]:
    """Remove settings that would change the inertias when the file is compiled; return a note on them."""
    removed = [key for _, keys in _altering_settings(text) for key in keys]
    for compiler, keys in _altering_settings(text):
        text.drop(compiler, keys)
    return (f"<compiler> {', '.join(removed)} removed, so that the inertias are used as written",) if removed else ()


def with_payload_link(xml: str, frame: str, mass: float, centre: Array, tensor: Array) -> str:
    """Return a URDF with a payload as a further link.

    It has ``mass`` (kg), ``centre`` of mass (3) in m and ``tensor`` (3, 3) in kg m^2 about this, both in the
    ``frame`` of the link to which a fixed joint ties it; all else is preserved byte by byte. Raises ModelError
    where the text is no URDF or has no such link.
    """
    text = XmlText(xml)
    links = {node.attributes.get("name", "") for node in text.root.children if node.tag == "link"}
    joints = {node.attributes.get("name", "") for node in text.root.children if node.tag == "joint"}
    if text.root.tag != "robot":
        raise ModelError("a payload is written into a URDF; this robot file is an MJCF.")
    if frame not in links:
        raise ModelError(f"the payload's frame {frame!r} is no link of the URDF.")
    name = _free_name(LINK_NAME, links)
    joint = _free_name(f"{name}_joint", joints)
    lines = (
        f'<link name="{name}">',
        *(f"  {line}" for line in _inertial_lines(mass, centre, tensor)),
        "</link>",
        f'<joint name="{joint}" type="fixed">',
        f"  {element('parent', link=frame)}",
        f"  {element('child', link=name)}",
        "</joint>",
    )
    text.insert(text.root, *lines)
    return str(text)


def _free_name(name: str, taken: Collection[str]) -> str:
    return next(candidate for candidate in chain([name], (f"{name}_{k}" for k in count(2))) if candidate not in taken)


def check_payload_link(before: str, after: str, bodies: RigidBodies, added: Array) -> float:
    """Compare the torque that a payload adds to a URDF with that of the parameters ``added`` (p) of its ``bodies``.

    Returns the largest relative difference; raises ModelError where it is more than rounding.
    """
    q, dq, ddq = np.random.default_rng(0).uniform(-3, 3, (3, 100, len(bodies.joints)))
    torques = []
    for text in (before, after):
        arm = RigidBodies(text, bodies.joints_used, bodies.locked, bodies.gravity, bodies.source, bodies.displacements)
        torques.append(arm.torque(q, dq, ddq, np.array([parameter.value or 0.0 for parameter in arm.parameters])))
    expected = bodies.torque(q, dq, ddq, added)
    error = float(np.abs(torques[1] - torques[0] - expected).max() / (np.abs(expected).max() or 1.0))
    if not error < MAX_TORQUE_DIFFERENCE:
        raise ModelError(f"the URDF with the payload, loaded again, has another torque (by {100 * error:.2g} %).")
    return error
