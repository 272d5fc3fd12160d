"""The formats that a model is exported to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import PurePath
from typing import Any, ClassVar
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml

from dynident.files.xml_text import XmlText
from dynident.models import RigidBodies, motion_memory
from dynident.project.export.identified import Drives, IdentifiedModel, drives
from dynident.project.export.numpy_module import identified_module
from dynident.project.export.robot_files import has_actuators, identified_mjcf, identified_urdf
from dynident.project.export.servos import constant_torques
from dynident.project.export.written import ExportText, Reader, States, place_values
from dynident.runtime import DynidentError, Noun
from dynident.runtime.arrays import Array

FRAME = (
    "mass, first moment and inertia of a body are about the origin of its joint's frame with the axes of its link; "
    "they contain all links that move with it"
)

SHAPE_TAGS = (
    "actuator", "asset", "camera", "collision", "contact", "custom", "deformable", "equality", "extension", "geom",
    "keyframe", "light", "material", "sensor", "site", "skin", "tendon", "visual",
)  # fmt: skip


def _parameter_row(identified: IdentifiedModel, k: int) -> dict[str, Any]:
    parameter = identified.model.parameters[k]
    row: dict[str, Any] = {"name": parameter.name, "value": float(identified.value[k])}
    if identified.std is not None:
        row["std"] = float(identified.std[k]) if np.isfinite(identified.std[k]) else None
    if identified.verdict:
        row["verdict"] = str(identified.verdict[k])
    row |= {"unit": parameter.unit, "meaning": parameter.expression}
    return row | ({"body": parameter.body} if parameter.body else {})


def torque_by_numpy(source: str, _: IdentifiedModel, states: States) -> Array:
    """Return the torque of a module's own inverse dynamics."""
    return np.asarray(run_module(source)["inverse_dynamics"](*states))


def run_module(source: str) -> dict[str, Any]:
    """Return the names of a module that was written here."""
    namespace: dict[str, Any] = {"__name__": "model"}
    exec(compile(source, "model.py", "exec"), namespace)  # noqa: S102 - names are quoted in it
    return namespace


def torque_by_yaml(text: str, identified: IdentifiedModel, states: States) -> Array:
    """Return the torque of the parameters in a YAML text, which must be the same to the last digit."""
    safe = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, where PyYAML was built with it
    values = {row["name"]: row["value"] for row in yaml.load(text, safe)["parameters"]}  # noqa: S506
    read_values = np.array([values[name] for name in identified.model.names])
    if (read_values != identified.value).any():  # of some, the torque says nothing
        raise DynidentError("a value differs")
    return identified.model.torque(*states, read_values, np.zeros((len(states[0]), identified.model.memory)))


def torque_by_dynident(text: str, identified: IdentifiedModel, states: States) -> Array:
    """Return the torque of a text that dynident itself reads."""
    bodies, _ = identified.bodies
    names = tuple(joint.name for joint in bodies.joints)
    reloaded = RigidBodies(text, names, bodies.locked, bodies.gravity, bodies.source)
    values = [parameter.value for parameter in reloaded.parameters]
    if None in values:
        raise DynidentError("a body has no inertia of its own")
    joint_drives = Drives(reloaded.damping, reloaded.friction, reloaded.armature)
    torque = reloaded.regressor(*states) @ np.array(values, dtype=float)
    return np.asarray(torque + joint_drives.torque(names, *states[1:]))


class PinocchioArm(Noun):
    """The ``bodies`` of an arm as Pinocchio reads them: its ``model``, whose joints have an order of their own."""

    model: Any
    bodies: RigidBodies

    @classmethod
    def of(cls, text: str, bodies: RigidBodies) -> PinocchioArm:
        """Read a URDF; ValueError or RuntimeError for names and structures that Pinocchio does not take."""
        import pinocchio as pin

        for joint in (node for node in XmlText(text).root.children if node.tag == "joint"):
            # its parser would say this to the terminal, too
            if joint.attributes.get("type") in ("revolute", "prismatic") and joint.find("limit") is None:
                raise ValueError(f"the joint {joint.attributes.get('name')!r} has no <limit>")
        model = pin.buildModelFromXML(declare_root(_remove_shapes(text), bodies.file.root))
        model.gravity = pin.Motion(np.array(bodies.gravity), np.zeros(3))
        return cls(model, bodies)

    @property
    def joint_ids(self) -> list[int]:
        """Pinocchio's numbers of the joints of the bodies; that of a joint it does not have is its number of joints."""
        return [self.model.getJointId(body.joint.name) for body in self.bodies.arm.bodies]

    @property
    def columns(self) -> list[int]:
        """The places of the joints of the bodies among Pinocchio's velocities."""
        return [self.model.joints[joint_id].idx_v for joint_id in self.joint_ids]

    def torque(self, states: States, inverse_dynamics: Callable[[Array, Array, Array], Array]) -> Array:
        """Return the torque (N, n) of the model's joints in ``states`` q, dq, ddq (N, n).

        ``inverse_dynamics`` gives Pinocchio's torque of its configuration, velocity and acceleration.
        """
        arm, joint_ids, columns = self.bodies.arm, self.joint_ids, self.columns
        standing = {
            self.model.getJointId(name): x for name, x in arm.fixed_positions.items() if self.model.existJointName(name)
        }
        out = np.empty((len(states[0]), len(columns)))
        for row, q, dq, ddq in zip(out, *arm.body_states(*states), strict=True):
            # velocities and accelerations by Pinocchio's numbering; joints that stand still have zeros
            rates = np.zeros((2, self.model.nv))
            rates[:, columns] = dq, ddq
            configuration = self._configuration(standing | dict(zip(joint_ids, q, strict=True)))
            row[:] = inverse_dynamics(configuration, *rates)[columns]
        # from the torques of the bodies' joints to those of the model's joints, which may drive several
        return np.asarray(out @ arm.drive)

    def _configuration(self, positions: Mapping[int, float]) -> Array:
        """Return the configuration for Pinocchio, in which a continuous joint is a point of a circle."""
        import pinocchio as pin

        out: Array = pin.neutral(self.model)
        for joint_id, x in positions.items():
            joint = self.model.joints[joint_id]
            if joint.nv == 1:
                out[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
        return out


def torque_by_pinocchio(text: str, identified: IdentifiedModel, states: States) -> Array:
    """Return the torque of a URDF that Pinocchio reads; fixed joints stay fixed in its full model."""
    import pinocchio as pin

    bodies, _ = identified.bodies
    arm = PinocchioArm.of(text, bodies)
    torque = arm.torque(states, partial(pin.rnea, arm.model, arm.model.createData()))
    driven = [arm.columns[k] for k in bodies.arm.driven]
    damping, friction = (np.asarray(x)[driven] for x in (arm.model.damping, arm.model.friction))
    return np.asarray(torque + damping * states[1] + friction * np.sign(states[1]))


def declare_root(text: str, root: str) -> str:
    """Return a URDF whose root link is declared: some exporters omit the world link that the base is fixed to."""
    edited = XmlText(text)
    if all(node.attributes.get("name") != root for node in edited.root.children if node.tag == "link"):
        edited.insert(edited.root, f"<link name={quoteattr(root)}/>")
    return str(edited)


def torque_by_mujoco(text: str, identified: IdentifiedModel, states: States) -> Array:
    """Return the torque of an MJCF, without its shapes, that MuJoCo reads.

    Friction is computed here, as that of MuJoCo is soft at rest.
    """
    import mujoco

    bodies, _ = identified.bodies
    if bodies.format == "urdf":  # the text needs no other file: its shapes, actuators and numbers are compiled, too
        mujoco.MjModel.from_xml_string(text)
    model = mujoco.MjModel.from_xml_string(_remove_shapes(text))
    # constraints and actuators would add forces to the inverse dynamics
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= off.mjDSBL_CONSTRAINT | off.mjDSBL_ACTUATION
    model.body_gravcomp[:] = 0.0
    model.opt.density = model.opt.viscosity = 0.0
    arm, data = bodies.arm, mujoco.MjData(model)
    joints = [model.joint(body.joint.name) for body in arm.bodies]
    columns = [int(joint.dofadr[0]) for joint in joints]
    places = [int(joint.qposadr[0]) for joint in joints]
    data.qpos[:] = model.qpos0
    # locked joints stand where the identification had them
    for name, position in arm.fixed_positions.items():
        data.qpos[model.joint(name).qposadr[0]] = position
    out = np.empty((len(states[0]), len(joints)))
    for row, q, dq, ddq in zip(out, *arm.body_states(*states), strict=True):
        data.qpos[places], data.qvel[columns], data.qacc[columns] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        row[:] = data.qfrc_inverse[columns]
    friction = model.dof_frictionloss[[columns[k] for k in arm.driven]]
    return np.asarray(out @ arm.drive + friction * np.sign(states[1]))


def _with_actuators(reader: Reader) -> Reader:
    """Return a reader that adds the constant torques of actuators, where the file is not that of the user."""

    def torque(text: str, identified: IdentifiedModel, states: States) -> Array:
        bodies, _ = identified.bodies
        names = [joint.name for joint in bodies.joints]
        constant = constant_torques(XmlText(text), names) if bodies.format == "urdf" else np.zeros(len(names))
        return reader(text, identified, states) + constant

    return torque


def _remove_shapes(text: str) -> str:
    """Return a robot file without shapes and what belongs to them: their files may be missing, and parsers complain."""
    edited = XmlText(text)
    todo = list(edited.root.children)
    while todo:
        node = todo.pop()
        if node.tag in SHAPE_TAGS:
            edited.delete(node)
        elif node.tag != "default":
            todo += node.children
    return str(edited)


@dataclass(frozen=True)
class RobotFile:
    """A file of a robot, whose name is that of the robot's own file with another ``ending``.

    Of the drives it holds damping, rotor inertia (``armature``; ``in_links``: in the links where it can be), and
    ``dry_friction``.
    """

    format: ClassVar[str]
    ending: ClassVar[str]
    armature: ClassVar[bool] = True
    in_links: ClassVar[bool] = False
    dry_friction: ClassVar[bool] = True

    def file(self, identified: IdentifiedModel) -> str:
        """Return the name of the file."""
        name = identified.robot.source if identified.robot else identified.model.name
        return f"{PurePath(name).stem}{self.ending}"

    def torque(self, identified: IdentifiedModel, states: States) -> Array:
        """Return the torque of the bodies and of what the file holds of the drives."""
        best = place_values(identified, armature=self.armature and not self.in_links)
        bodies, values = best.bodies
        joint_drives = drives(best, armature=self.armature, offset=has_actuators(self.format, bodies))
        joint_drives = joint_drives if self.dry_friction else replace(joint_drives, friction={})
        names = tuple(joint.name for joint in bodies.joints)
        return np.asarray(bodies.torque(*states, values.ravel()) + joint_drives.torque(names, *states[1:]))


class Urdf(RobotFile):
    """The robot's own URDF, or one of its MJCF, with the identified inertias, damping and friction."""

    format: ClassVar[str] = "urdf"
    ending, armature = ".identified.urdf", False
    readers: ClassVar[Mapping[str, Reader]] = {"Pinocchio": torque_by_pinocchio, "dynident": torque_by_dynident}

    def write(self, identified: IdentifiedModel) -> ExportText:
        """Return the URDF."""
        return identified_urdf(identified)


class Mjcf(RobotFile):
    """The robot's own MJCF, or one of its URDF, with the identified inertias, damping, friction and armature."""

    format: ClassVar[str] = "mjcf"
    ending = ".identified.xml"
    readers: ClassVar[Mapping[str, Reader]] = {
        "MuJoCo": _with_actuators(torque_by_mujoco),
        "dynident": _with_actuators(torque_by_dynident),
    }

    def write(self, identified: IdentifiedModel) -> ExportText:
        """Return the MJCF."""
        return identified_mjcf(identified)


@dataclass(frozen=True)
class Numpy:
    """A Python module that needs only NumPy."""

    format: ClassVar[str] = "numpy"
    readers: ClassVar[Mapping[str, Reader]] = {"NumPy": torque_by_numpy}

    def file(self, identified: IdentifiedModel) -> str:  # noqa: ARG002
        """Return model.py."""
        return "model.py"

    def write(self, identified: IdentifiedModel) -> ExportText:
        """Return the module."""
        return identified_module(identified)

    def torque(self, identified: IdentifiedModel, states: States) -> Array:
        """Return the torque of all terms except those that remember more than the load."""
        memoryless = identified.memoryless
        memory = motion_memory(memoryless.model, np.zeros(len(states[0])), *states)
        return memoryless.model.torque(*states, memoryless.value, memory)


@dataclass(frozen=True)
class Yaml:
    """All parameters by name, with units and meanings."""

    format: ClassVar[str] = "yaml"
    readers: ClassVar[Mapping[str, Reader]] = {"YAML": torque_by_yaml}

    def file(self, identified: IdentifiedModel) -> str:  # noqa: ARG002
        """Return parameters.yaml."""
        return "parameters.yaml"

    def write(self, identified: IdentifiedModel) -> ExportText:
        """Return the parameters: any values can be held."""
        model = identified.model
        joints = [{"name": joint.name, "kind": joint.kind, "unit": joint.unit} for joint in model.joints]
        data: dict[str, Any] = {"model": model.name, "frames": FRAME, "joints": joints}
        if (robot := identified.robot) is not None:
            merged = {body: list(links) for body, links in robot.merged_links.items()}
            data["robot"] = {"file": robot.source, "gravity": list(robot.gravity), "locked": dict(robot.locked)}
            data["robot"]["merged"] = merged
        data["parameters"] = [_parameter_row(identified, k) for k in range(len(model.parameters))]
        return ExportText(yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=120))

    def torque(self, identified: IdentifiedModel, states: States) -> Array:
        """Return the torque of all terms, with the memory of those that have one at zero."""
        return identified.model.torque(*states, identified.value, np.zeros((len(states[0]), identified.model.memory)))
