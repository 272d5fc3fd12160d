"""The identified model for Drake, Pinocchio and Isaac Lab, each with reflected rotor inertia."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import yaml

from dynident.files.xml_text import XmlNode, XmlText
from dynident.models import RigidBodies
from dynident.models.friction import Coulomb
from dynident.project.export.formats import (
    PinocchioArm,
    RobotFile,
    Urdf,
    declare_root,
    run_module,
    torque_by_dynident,
    torque_by_pinocchio,
)
from dynident.project.export.identified import Drives, IdentifiedModel, Servo, drives, omission_notes
from dynident.project.export.robot_files import edit_urdf, identified_urdf
from dynident.project.export.servos import range_comment, ranges
from dynident.project.export.simulator_code import ISAAC, PINOCCHIO
from dynident.project.export.tree_text import element
from dynident.project.export.written import ExportText, Reader, States, place_values
from dynident.runtime import DynidentError
from dynident.runtime.arrays import Array

DRAKE_NAMESPACE = "http://drake.mit.edu"
DRAKE_MODEL, DRAKE_PACKAGE = "arm", "dynident"  # names in model directives
DRAKE_MESHES = ".obj", ".vtk", ".gltf"  # of shapes that collide
EARTH = 9.81  # m/s^2, gravity of a world of Drake
SHAPES = ("visual", "collision")
CHECKED_STATES = 5  # that a Pinocchio file compares when it is run


def _with_reflected_inertia(reader: Reader) -> Reader:
    """Return a reader that adds Drake's rotor inertia, and leaves out friction, which Drake ignores."""

    def torque(text: str, identified: IdentifiedModel, states: States) -> Array:
        bodies, _ = identified.bodies
        edited = XmlText(text)
        inertia = dict(_reflected_inertias(edited))
        for node in edited.root.walk():
            if node.tag == "dynamics" and "friction" in node.attributes:
                edited.set(node, {"friction": "0"})
        reflected = np.array([inertia.get(joint.name, 0.0) for joint in bodies.joints])
        return reader(str(edited), identified, states) + reflected * states[2]

    return torque


def _reflected_inertias(text: XmlText) -> Iterator[tuple[str, float]]:
    """Yield joints and rotor inertia times the square of the gear ratio, as Drake reads them."""
    for transmission in (node for node in text.root.children if node.tag == "transmission"):
        joint, actuator = transmission.find("joint"), transmission.find("actuator")
        if joint is not None and actuator is not None:
            inertia, gear = (_value(actuator, name) for name in ("rotor_inertia", "gear_ratio"))
            yield joint.attributes.get("name", ""), (inertia or 0.0) * (1.0 if gear is None else gear) ** 2


def _value(actuator: XmlNode, name: str) -> float | None:
    node = actuator.find(f"drake:{name}")
    return None if node is None else float(node.attributes["value"])


class Drake(RobotFile):
    """A URDF with the elements of Drake for rotor inertia, gear ratio, gains; Drake has no dry friction of joints."""

    format: ClassVar[str] = "drake"
    ending, dry_friction = ".identified.drake.urdf", False
    readers: ClassVar[Mapping[str, Reader]] = {
        "Pinocchio": _with_reflected_inertia(torque_by_pinocchio),
        "dynident": _with_reflected_inertia(torque_by_dynident),
    }

    def write(self, identified: IdentifiedModel) -> ExportText:
        """Return the URDF."""
        made = _drake_urdf(identified)
        gravity = f"gravity {identified.bodies[0].gravity} m/s^2 in the frame of the root link: set it in the plant"
        return replace(made, notes=(*made.notes, gravity))


def _drake_urdf(identified: IdentifiedModel) -> ExportText:
    """Return the URDF for Drake, without a word of gravity."""
    text, joint_drives, notes = edit_urdf(identified, armature=True)
    text.set(text.root, {"xmlns:drake": DRAKE_NAMESPACE})
    parts = [(node, child) for node in text.root.children if node.tag == "transmission" for child in node.children]
    transmissions = {child.attributes.get("name"): node for node, child in parts if child.tag == "joint"}
    for name in (joint.name for joint in identified.bodies[0].joints):
        lines = _drake_lines(joint_drives.armature.get(name, 0.0), identified.servos.get(name, Servo()))
        _set_transmission(text, transmissions.get(name), name, lines)
    if comment := [*range_comment(ranges(identified, joint_drives))]:
        text.insert(text.root, *comment)
    dry = ((term, values) for term, values in identified.parts if isinstance(term, Coulomb))
    friction = (note for term, values in dry for note in omission_notes(term, values))
    shapes = [node for node in text.root.walk() if node.tag == "collision"]
    meshes = [node.attributes.get("filename", "") for shape in shapes for node in shape.walk() if node.tag == "mesh"]
    if unread := [name for name in meshes if not name.lower().endswith(DRAKE_MESHES)]:
        notes = (*notes, f"Drake reads no collision meshes such as {unread[0]}: convert them to .obj")
    return ExportText(str(text), (*joint_drives.left_out, *friction), notes)


def torque_by_directives(text: str, identified: IdentifiedModel, states: States) -> Array:
    """Return the torque of the URDF for Drake, welded by model directives into a world where gravity points down."""
    from scipy.spatial.transform import Rotation  # slow to import

    bodies, _ = identified.bodies
    _, weld = yaml.load(text, _Directives)["directives"]  # noqa: S506 - a safe loader with one more tag
    angles = np.radians(weld["add_weld"]["X_PC"]["rotation"])
    down = Rotation.from_euler("xyz", angles).inv().apply([0.0, 0.0, -np.linalg.norm(bodies.gravity)])
    if not np.allclose(down, bodies.gravity, atol=1e-9) or weld["add_weld"]["child"] != _drake_root(bodies):
        raise DynidentError("gravity differs")
    return Drake.readers["dynident"](_drake_urdf(identified).text, identified, states)


class _Directives(yaml.SafeLoader):
    """A loader of YAML that knows how Drake writes angles."""


def _read_angles(loader: yaml.SafeLoader, node: yaml.MappingNode) -> Any:
    return loader.construct_mapping(node, deep=True)["deg"]


_Directives.add_constructor("!Rpy", _read_angles)


def _drake_root(bodies: RigidBodies) -> str:
    return f"{DRAKE_MODEL}::{bodies.file.root}"


class DrakeDirectives(RobotFile):
    """Model directives of Drake: the URDF for it, with its root welded so that gravity acts as in the model."""

    format: ClassVar[str] = "drake_directives"
    ending, dry_friction = ".identified.drake.dmd.yaml", False
    readers: ClassVar[Mapping[str, Reader]] = {"dynident": torque_by_directives}

    def write(self, identified: IdentifiedModel) -> ExportText:
        """Return the directives, in which names are quoted."""
        from scipy.spatial.transform import Rotation

        bodies, urdf, name = identified.bodies[0], _drake_urdf(identified), Drake().file(identified)
        w, *axis = _upright(bodies.gravity)
        angles = np.degrees(Rotation.from_quat([*axis, w]).as_euler("xyz")).tolist()
        lines = [
            "directives:",
            f"- add_model: {{ name: {DRAKE_MODEL}, file: {json.dumps(f'package://{DRAKE_PACKAGE}/{name}')} }}",
            f"- add_weld:\n    parent: world\n    child: {json.dumps(_drake_root(bodies))}",
            f"    X_PC: {{ rotation: !Rpy {{ deg: {angles} }} }}",
        ]
        size = float(np.linalg.norm(bodies.gravity))
        world = [] if abs(size - EARTH) < 1e-6 else [f"gravity of {size:g} m/s^2: set it in the plant"]
        beside = f"it names {name}: write that file beside it by --format drake, and name their folder to Drake by "
        beside += f"parser.package_map().Add({DRAKE_PACKAGE!r}, folder)"
        return ExportText("\n".join(lines) + "\n", urdf.left_out, (*urdf.notes, *world, beside))


def _drake_lines(armature: float, servo: Servo) -> list[str]:
    gains = [element("drake:controller_gains", p=servo.kp, d=servo.kd)] if servo.kp else []
    inertia = element("drake:rotor_inertia", value=armature / servo.gear**2)
    return [inertia, element("drake:gear_ratio", value=servo.gear), *gains]


def _set_transmission(text: XmlText, node: XmlNode | None, joint: str, lines: list[str]) -> None:
    """Set the elements of Drake in the actuator of a joint, or insert a transmission with one."""
    actuator = None if node is None else node.find("actuator")
    if actuator is not None:
        tags = {line[1:].split()[0] for line in lines}
        for child in actuator.children:
            if child.tag in tags:
                text.delete(child)
        text.insert(actuator, *lines)
    else:
        name = element("actuator", name=f"{joint} motor").replace("/>", ">")
        text.insert(
            text.root,
            element("transmission", name=f"{joint} transmission").replace("/>", ">"),
            "  <type>transmission_interface/SimpleTransmission</type>",
            f"  {element('joint', name=joint)}",
            f"  {name}",
            *(f"    {line}" for line in lines),
            "  </actuator>",
            "</transmission>",
        )


def joint_table(identified: IdentifiedModel, joint_drives: Drives) -> dict[str, dict[str, float]]:
    """Return what simulators set at joints: by attribute the values of the joints that have any."""
    bodies, _ = identified.bodies
    names = [joint.name for joint in bodies.joints]
    servos = {name: identified.servos.get(name, Servo()) for name in names}
    efforts = {name: servos[name].limit or bodies.limits[name].effort for name in names}
    return {
        "ARMATURE": {name: joint_drives.armature.get(name, 0.0) for name in names},
        "FRICTION": {name: joint_drives.friction.get(name, 0.0) for name in names},
        "VISCOUS_FRICTION": {name: joint_drives.damping.get(name, 0.0) for name in names},
        "STIFFNESS": {name: servo.kp or 0.0 for name, servo in servos.items()},
        "DAMPING": {name: servo.kd for name, servo in servos.items()},
        "EFFORT_LIMIT": {name: effort for name, effort in efforts.items() if effort},
        "GEAR_RATIO": {name: servo.gear for name, servo in servos.items()},
        "DELAY": {name: servo.delay for name, servo in servos.items() if servo.delay},
    }


def range_table(identified: IdentifiedModel, joint_drives: Drives) -> dict[str, dict[str, tuple[float, float]]]:
    """Return the ranges by attribute and name."""
    table: dict[str, dict[str, tuple[float, float]]] = {}
    for entry in ranges(identified, joint_drives):
        table.setdefault(entry.attribute, {})[entry.name] = entry.low, entry.high
    return table


def assignments(**values: object) -> str:
    """Return lines that assign literals; texts in them are quoted as Python has it, in ASCII alone."""
    return "\n".join(f"{name} = {value!a}" for name, value in values.items())


def read_literals(source: str) -> dict[str, Any]:
    """Return the names that a module assigns a literal to; nothing is run."""
    literals = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            try:
                literals[node.targets[0].id] = ast.literal_eval(node.value)
            except ValueError:
                continue
    return literals


def torque_by_isaac_values(text: str, identified: IdentifiedModel, states: States) -> Array:
    """Return the torque of the URDF that an Isaac Lab module names and of its values."""
    joint_values = read_literals(text)
    urdf = XmlText(identified_urdf(identified).text)
    for node in urdf.root.walk():
        if node.tag == "dynamics":  # those of the module are used in their place
            urdf.set(node, {"damping": "0", "friction": "0"})
    joint_drives = Drives(*(joint_values[name] for name in ("VISCOUS_FRICTION", "FRICTION", "ARMATURE")))
    names = tuple(joint.name for joint in identified.model.joints)
    return torque_by_dynident(str(urdf), identified, states) + joint_drives.torque(names, *states[1:])


class IsaacLab(RobotFile):
    """A module with the ``ArticulationCfg`` of Isaac Lab, for the identified URDF beside it."""

    format: ClassVar[str] = "isaac"
    ending, in_links = "_isaac.py", True
    readers: ClassVar[Mapping[str, Reader]] = {"dynident": torque_by_isaac_values}

    def write(self, identified: IdentifiedModel) -> ExportText:
        """Return the module."""
        gravity, name = identified.bodies[0].gravity, Urdf().file(identified)
        # rotor inertia that the URDF holds in its links is not set at the joint once more
        joint_drives = drives(place_values(identified, armature=False), armature=True)
        literals = assignments(
            URDF=name, GRAVITY=gravity, BASE_ORIENTATION=_upright(gravity),
            **joint_table(identified, joint_drives), RANGES=range_table(identified, joint_drives),
        )  # fmt: skip
        note = f"the module names {name}, which has the inertias: write that file beside it by --format urdf"
        notes = (*identified_urdf(identified).notes, note)
        return ExportText(ISAAC.replace("#LITERALS", literals), joint_drives.left_out, notes)


def _upright(gravity: tuple[float, ...]) -> tuple[float, ...]:
    """Return the orientation (w, x, y, z) of a base in which gravity is as given, in a world where it points to -z."""
    down, target = np.asarray(gravity) / (np.linalg.norm(gravity) or 1.0), np.array([0.0, 0.0, -1.0])
    w, axis = 1.0 + down @ target, np.cross(down, target)
    quaternion = np.array([w, *axis]) if w > 1e-9 else np.array([0.0, 1.0, 0.0, 0.0])
    return tuple((quaternion / np.linalg.norm(quaternion)).tolist())


def _driven_joints(bodies: RigidBodies) -> dict[str, tuple[str, float, float]]:
    """Return by moving joint the joint of the model that drives it, with factor and offset of its position."""
    driven = {}
    for body, row, offset in zip(bodies.arm.bodies, bodies.arm.drive, bodies.arm.offset.tolist(), strict=True):
        k = int(np.flatnonzero(row)[0])
        driven[body.joint.name] = bodies.joints[k].name, float(row[k]), offset
    return driven


def torque_by_pinocchio_file(text: str, identified: IdentifiedModel, states: States) -> Array:
    """Return the torque that the module computes itself."""
    namespace = run_module(text)
    namespace["check"]()
    bodies, _ = identified.bodies
    model = namespace["load"]()
    return PinocchioArm(model, bodies).torque(states, partial(namespace["inverse_dynamics"], model, model.createData()))


class PinocchioFile(RobotFile):
    """A module that builds the model of Pinocchio, with rotor inertia, friction and damping, and checks itself."""

    format: ClassVar[str] = "pinocchio"
    ending = "_pinocchio.py"
    readers: ClassVar[Mapping[str, Reader]] = {"Pinocchio": torque_by_pinocchio_file}

    def write(self, identified: IdentifiedModel) -> ExportText:
        """Return the module."""
        bodies, _ = identified.bodies
        text, joint_drives, notes = edit_urdf(identified, armature=True)
        for node in text.root.children:
            for child in node.children:
                if child.tag in SHAPES:
                    text.delete(child)
        states = np.random.default_rng(0).uniform(-1, 1, (3, CHECKED_STATES, len(bodies.joints)))
        table = joint_table(identified, joint_drives)
        literals = assignments(
            URDF=declare_root(str(text), bodies.file.root),
            GRAVITY=bodies.gravity,
            JOINTS=tuple(joint.name for joint in bodies.joints),
            DRIVEN=_driven_joints(bodies),
            FIXED_POSITIONS=dict(bodies.arm.fixed_positions),
            **{name: table[name] for name in ("ARMATURE", "GEAR_RATIO", "FRICTION", "VISCOUS_FRICTION")},
            RANGES=range_table(identified, joint_drives),
            STATES=states.tolist(),
            TORQUES=self.torque(identified, (states[0], states[1], states[2])).tolist(),
        )
        return ExportText(PINOCCHIO.replace("#LITERALS", literals), joint_drives.left_out, notes)
