"""Loads a written model again, by readers that are independent where there are any, and compares its torque."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml
from numpy.typing import NDArray

from dynident.errors import DynidentError
from dynident.export.edit import Text
from dynident.export.identified import Identified, drives
from dynident.export.written import Format, Proof, Written
from dynident.log import Motion, subsample
from dynident.terms import Bodies

__all__ = ["prove", "random_states", "spread"]

Array = NDArray[np.float64]
States = tuple[Array, Array, Array]
Reader = Callable[[str, Identified, States], Array]
SMALL = 1e-6  # a joint's torque counts as no smaller than this share of the largest joint's
SHAPES = (
    "actuator", "asset", "camera", "contact", "custom", "deformable", "equality", "extension", "geom", "keyframe",
    "light", "sensor", "site", "skin", "tendon", "visual",
)  # fmt: skip


def spread(motions: tuple[Motion, ...], count: int = 500) -> States:
    """Return q, dq, ddq of about ``count`` usable samples (N, n), evenly spread over the motions."""
    pairs = list(zip(motions, subsample(motions, count), strict=True))
    names = ("q", "dq", "ddq")
    q, dq, ddq = (np.concatenate([getattr(motion, name)[rows] for motion, rows in pairs]) for name in names)
    return q, dq, ddq


def random_states(joints: int, rng: np.random.Generator, count: int = 500) -> States:
    """Return random q, dq, ddq (count, joints) of a few rad or m, per s and per s^2, where no motion is at hand."""
    q, dq, ddq = rng.uniform(-3, 3, (3, count, joints))
    return q, dq, ddq


def prove(written: Written, identified: Identified, states: States) -> Proof:
    """Return how well the torque of the text, loaded again, agrees with the model without what is left out."""
    expected = _expected(written, identified, states)
    found: dict[str, float] = {}
    skipped: list[str] = []
    for name, reader in READERS[written.format].items():
        if name == "MuJoCo" and importlib.util.find_spec("mujoco") is None:
            skipped.append("MuJoCo is not installed (the extra `mujoco`)")
            continue
        try:
            found[name] = _difference(reader(written.text, identified, states), expected)
        except Exception as error:  # a foreign parser may raise anything
            reason = " ".join(str(error).split())
            if name in FOREIGN and _fails(reader, identified):
                skipped.append(f"{name} can read neither this nor the original file: {reason}")
            else:
                found[name] = float("inf")
                skipped.append(f"{name} cannot read it: {reason}")
    return Proof(found, len(expected), tuple(skipped))


def _difference(torque: Array, expected: Array) -> float:
    size = np.linalg.norm(expected, axis=0)
    scale = np.maximum(size, SMALL * size.max())
    error = np.linalg.norm(torque - expected, axis=0)
    worst = np.divide(error, scale, out=np.where(error > 0, np.inf, 0.0), where=scale > 0).max()
    return float(worst) if np.isfinite(worst) else float("inf")


def _expected(written: Written, identified: Identified, states: States) -> Array:
    if written.format in ("numpy", "yaml"):
        return identified.model.torque(*states, identified.value)
    bodies, values = identified.bodies
    names = tuple(joint.name for joint in bodies.joints)
    held = drives(identified, armature=written.format == "mjcf")
    return np.asarray(bodies.regressor(*states) @ values.ravel() + held.torque(names, *states[1:]))


def _fails(reader: Reader, identified: Identified) -> bool:
    """Whether a reader cannot read the original file either."""
    bodies, _ = identified.bodies
    none: Array = np.zeros((0, len(bodies.joints)))
    try:
        reader(bodies.xml, identified, (none, none, none))
    except Exception:  # a foreign parser may raise anything
        return True
    return False


def _run(source: str, _: Identified, states: States) -> Array:
    namespace: dict[str, Any] = {"__name__": "model"}
    exec(compile(source, "model.py", "exec"), namespace)  # noqa: S102 - the text was written above, names are quoted
    return np.asarray(namespace["inverse_dynamics"](*states))


def _listed(text: str, identified: Identified, states: States) -> Array:
    values = {row["name"]: row["value"] for row in yaml.safe_load(text)["parameters"]}
    given = np.array([values[name] for name in identified.model.names])
    if (given != identified.value).any():  # of some, the torque says nothing
        raise DynidentError("a value is another one")
    return identified.model.torque(*states, given)


def _own(text: str, identified: Identified, states: States) -> Array:
    """Read the text as an identification would."""
    bodies, _ = identified.bodies
    names = tuple(joint.name for joint in bodies.joints)
    again = Bodies(text, names, bodies.locked, bodies.gravity, bodies.source)
    values = [parameter.value for parameter in again.parameters]
    if None in values:
        raise DynidentError("a body has no inertia of its own")
    held = [np.array([given.get(name, 0.0) for name in names]) for given in (again.damping, again.friction)]
    rotor = np.array([again.armature.get(name, 0.0) for name in names])
    _, dq, ddq = states
    torque = again.regressor(*states) @ np.array(values, dtype=float)
    return np.asarray(torque + held[0] * dq + held[1] * np.sign(dq) + rotor * ddq)


def _pinocchio(text: str, identified: Identified, states: States) -> Array:
    """Read a URDF by Pinocchio's own reader; the joints that stand still do so in its full model."""
    import pinocchio as pin

    bodies, _ = identified.bodies
    model = pin.buildModelFromXML(_declared(text, bodies.file.root))
    data, names = model.createData(), [joint.name for joint in bodies.joints]
    model.gravity = pin.Motion(np.array(bodies.gravity), np.zeros(3))
    columns = [model.joints[model.getJointId(name)].idx_v for name in names]
    standing = {name: x for name, x in bodies.arm.standing.items() if model.existJointName(name)}

    def position(q: Array) -> Array:
        out: Array = pin.neutral(model)
        for name, x in {**standing, **dict(zip(names, q, strict=True))}.items():
            joint = model.joints[model.getJointId(name)]
            if joint.nv == 1:
                out[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
        return out

    out = np.empty(states[0].shape)
    for row, q, dq, ddq in zip(out, *states, strict=True):
        full = np.zeros((2, model.nv))
        full[:, columns] = dq, ddq
        row[:] = pin.rnea(model, data, position(q), *full)[columns]
    damping, friction = (np.asarray(x)[columns] for x in (model.damping, model.friction))
    return np.asarray(out + damping * states[1] + friction * np.sign(states[1]))


def _declared(text: str, root: str) -> str:
    """Return a URDF whose root link is declared: exporters leave out the world that the base is welded to."""
    edited = Text(text)
    if all(node.attributes.get("name") != root for node in edited.root.children if node.tag == "link"):
        edited.insert(edited.root, f"<link name={quoteattr(root)}/>")
    return str(edited)


def _mujoco(text: str, identified: Identified, states: States) -> Array:
    """Read an MJCF, without its shapes, by MuJoCo; friction is taken from its model, as its own yields at rest."""
    import mujoco

    bodies, _ = identified.bodies
    model = mujoco.MjModel.from_xml_string(_bare(text))
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= off.mjDSBL_CONSTRAINT | off.mjDSBL_ACTUATION
    model.body_gravcomp[:] = 0.0
    model.opt.density = model.opt.viscosity = 0.0
    data, joints = mujoco.MjData(model), [model.joint(joint.name) for joint in bodies.joints]
    columns = [int(joint.dofadr[0]) for joint in joints]
    places = [int(joint.qposadr[0]) for joint in joints]
    data.qpos[:] = model.qpos0
    for name, position in bodies.arm.standing.items():
        data.qpos[model.joint(name).qposadr[0]] = position
    out = np.empty(states[0].shape)
    for row, q, dq, ddq in zip(out, *states, strict=True):
        data.qpos[places], data.qvel[columns], data.qacc[columns] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        row[:] = data.qfrc_inverse[columns]
    return np.asarray(out + model.dof_frictionloss[columns] * np.sign(states[1]))


def _bare(text: str) -> str:
    """Return an MJCF without shapes and what refers to them: their files need not be there."""
    edited = Text(text)
    todo = list(edited.root.children)
    while todo:
        node = todo.pop()
        if node.tag in SHAPES:
            edited.delete(node)
        elif node.tag != "default":
            todo += node.children
    return str(edited)


READERS: dict[Format, dict[str, Reader]] = {
    "urdf": {"Pinocchio": _pinocchio, "dynident": _own},
    "mjcf": {"MuJoCo": _mujoco, "dynident": _own},
    "numpy": {"NumPy": _run},
    "yaml": {"YAML": _listed},
}
FOREIGN = ("Pinocchio", "MuJoCo")
