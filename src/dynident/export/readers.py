"""Readers of written models, independent of this library where there are any: text in, torque out."""

from __future__ import annotations

from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml
from numpy.typing import NDArray

from dynident.errors import DynidentError
from dynident.export.edit import Text
from dynident.export.exporter import States
from dynident.export.identified import Identified
from dynident.models import RigidBodies

__all__ = ["by_dynident", "by_mujoco", "by_numpy", "by_pinocchio", "by_yaml", "declared"]

Array = NDArray[np.float64]
SHAPES = (
    "actuator", "asset", "camera", "contact", "custom", "deformable", "equality", "extension", "geom", "keyframe",
    "light", "sensor", "site", "skin", "tendon", "visual",
)  # fmt: skip


def by_numpy(source: str, _: Identified, states: States) -> Array:
    """Run a module and call its inverse dynamics."""
    namespace: dict[str, Any] = {"__name__": "model"}
    exec(compile(source, "model.py", "exec"), namespace)  # noqa: S102 - the text was written above, names are quoted
    return np.asarray(namespace["inverse_dynamics"](*states))


def by_yaml(text: str, identified: Identified, states: States) -> Array:
    """Read all parameters, which must be the same to the last digit."""
    safe = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, where PyYAML was built with it
    values = {row["name"]: row["value"] for row in yaml.load(text, safe)["parameters"]}  # noqa: S506
    given = np.array([values[name] for name in identified.model.names])
    if (given != identified.value).any():  # of some, the torque says nothing
        raise DynidentError("a value differs")
    return identified.model.torque(*states, given, np.zeros((len(states[0]), identified.model.memory)))


def by_dynident(text: str, identified: Identified, states: States) -> Array:
    """Read the text by dynident itself."""
    bodies, _ = identified.bodies
    names = tuple(joint.name for joint in bodies.joints)
    again = RigidBodies(text, names, bodies.locked, bodies.gravity, bodies.source)
    values = [parameter.value for parameter in again.parameters]
    if None in values:
        raise DynidentError("a body has no inertia of its own")
    held = [np.array([given.get(name, 0.0) for name in names]) for given in (again.damping, again.friction)]
    rotor = np.array([again.armature.get(name, 0.0) for name in names])
    _, dq, ddq = states
    torque = again.regressor(*states) @ np.array(values, dtype=float)
    return np.asarray(torque + held[0] * dq + held[1] * np.sign(dq) + rotor * ddq)


def by_pinocchio(text: str, identified: Identified, states: States) -> Array:
    """Read a URDF by Pinocchio's own reader; fixed joints are held fixed in its full model."""
    import pinocchio as pin

    bodies, _ = identified.bodies
    model = pin.buildModelFromXML(declared(text, bodies.file.root))
    arm, data = bodies.arm, model.createData()
    names = [body.joint.name for body in arm.bodies]
    model.gravity = pin.Motion(np.array(bodies.gravity), np.zeros(3))
    columns = [model.joints[model.getJointId(name)].idx_v for name in names]
    standing = {name: x for name, x in arm.standing.items() if model.existJointName(name)}

    def position(q: Array) -> Array:
        """Return the configuration of Pinocchio, in which a continuous joint is a point of a circle."""
        out: Array = pin.neutral(model)
        for name, x in {**standing, **dict(zip(names, q, strict=True))}.items():
            joint = model.joints[model.getJointId(name)]
            if joint.nv == 1:
                out[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
        return out

    out = np.empty((len(states[0]), len(names)))
    for row, q, dq, ddq in zip(out, *arm.moved(*states), strict=True):
        full = np.zeros((2, model.nv))
        full[:, columns] = dq, ddq
        row[:] = pin.rnea(model, data, position(q), *full)[columns]
    own = [columns[k] for k in arm.driven]
    damping, friction = (np.asarray(x)[own] for x in (model.damping, model.friction))
    return np.asarray(out @ arm.drive + damping * states[1] + friction * np.sign(states[1]))


def declared(text: str, root: str) -> str:
    """Return a URDF whose root link is declared: some exporters omit the world link that the base is fixed to."""
    edited = Text(text)
    if all(node.attributes.get("name") != root for node in edited.root.children if node.tag == "link"):
        edited.insert(edited.root, f"<link name={quoteattr(root)}/>")
    return str(edited)


def by_mujoco(text: str, identified: Identified, states: States) -> Array:
    """Read an MJCF, without its shapes, by MuJoCo; friction is computed here, as MuJoCo's is soft at rest."""
    import mujoco

    bodies, _ = identified.bodies
    model = mujoco.MjModel.from_xml_string(_bare(text))
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= off.mjDSBL_CONSTRAINT | off.mjDSBL_ACTUATION
    model.body_gravcomp[:] = 0.0
    model.opt.density = model.opt.viscosity = 0.0
    arm, data = bodies.arm, mujoco.MjData(model)
    joints = [model.joint(body.joint.name) for body in arm.bodies]
    columns = [int(joint.dofadr[0]) for joint in joints]
    places = [int(joint.qposadr[0]) for joint in joints]
    data.qpos[:] = model.qpos0
    for name, position in arm.standing.items():
        data.qpos[model.joint(name).qposadr[0]] = position
    out = np.empty((len(states[0]), len(joints)))
    for row, q, dq, ddq in zip(out, *arm.moved(*states), strict=True):
        data.qpos[places], data.qvel[columns], data.qacc[columns] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        row[:] = data.qfrc_inverse[columns]
    friction = model.dof_frictionloss[[columns[k] for k in arm.driven]]
    return np.asarray(out @ arm.drive + friction * np.sign(states[1]))


def _bare(text: str) -> str:
    """Return an MJCF without shapes and references to them, whose files may be missing."""
    edited = Text(text)
    todo = list(edited.root.children)
    while todo:
        node = todo.pop()
        if node.tag in SHAPES:
            edited.delete(node)
        elif node.tag != "default":
            todo += node.children
    return str(edited)
