"""The robot file of a servo arm: as MuJoCo simulates it, and written with the identified values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from dynident.apps.servo.backlash import add_gaps
from dynident.apps.servo.plant import ServoLog, ServoPlant, compile_plant, ignore_divergence, import_mujoco
from dynident.apps.servo.values import ServoValues
from dynident.files.xml_text import XmlNode, XmlText
from dynident.project.config import robot_text
from dynident.project.settings import RobotSettings
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array

UNSEEN = ("visual", "collision", "transmission", "gazebo", "material")  # of a URDF: what the motion does not need
MAX_ROLLOUT_DIFFERENCE = 1e-6  # rad or m, of the written file from the model that was fitted
MAX_PROOF_STEPS = 2000
EARTH_GRAVITY = (0.0, 0.0, -9.81)


def mjcf_text(path: Path) -> str:
    """Return the robot file as an MJCF with all that it includes; a URDF as MuJoCo reads it, without its shapes."""
    mujoco = import_mujoco()
    text = robot_text(path)
    xml = XmlText(text)
    if xml.root.tag == "mujoco":
        return text
    for node in xml.root.walk():
        if node.tag in UNSEEN and node is not xml.root:
            xml.delete(node)
    try:
        # MuJoCo keeps links without moving joints apart, as the file has them
        outer = XmlText(str(xml))
        outer.insert(outer.root, '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco>')
        spec = mujoco.MjSpec.from_string(str(outer))
        spec.compile()
        return str(spec.to_xml())
    except ValueError as error:
        raise ModelError(f"{path.name}: MuJoCo cannot compile it: {error}") from error


def load_plant(
    settings: RobotSettings, text: str, joints: Sequence[str], source: str, gaps: Sequence[str] = ()
) -> ServoPlant:
    """Return the plant of an MJCF text: shapes made of meshes are left out, locked joints stand still, and some
    joints have ``gaps`` behind them.

    Raises ModelError where MuJoCo cannot compile it.
    """
    spec = _spec(settings, text, source)
    add_gaps(spec, gaps)
    return compile_plant(spec, joints, source)


def _spec(settings: RobotSettings, text: str, source: str) -> Any:
    """Return MuJoCo's specification of an MJCF text, without what needs other files and with its joints locked."""
    mujoco = import_mujoco()
    try:
        spec = mujoco.MjSpec.from_string(text)
    except ValueError as error:
        raise ModelError(f"{source}: MuJoCo cannot read it: {error}") from error
    kinds = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)
    for geom in [geom for geom in spec.geoms if geom.type in kinds]:
        spec.delete(geom)
    for geom in spec.geoms:
        geom.material = ""
    # keyframes and sensors name joints that may be locked, and the motion needs neither
    for element in (
        *spec.skins,
        *spec.meshes,
        *spec.hfields,
        *spec.materials,
        *spec.textures,
        *spec.keys,
        *spec.sensors,
    ):
        spec.delete(element)
    if settings.gravity != EARTH_GRAVITY:
        spec.option.gravity = settings.gravity
    if settings.lock:
        _lock_joints(spec, settings.lock, source)
    return spec


def _lock_joints(spec: Any, lock: Any, source: str) -> None:
    """Remove joints and what acts on them alone, and place their bodies where these hold them.

    ModelError where something else needs a joint.
    """
    mujoco = import_mujoco()
    try:
        model = spec.copy().compile()
        data, positions = mujoco.MjData(model), dict(lock)
        # what follows a locked joint stands still, too
        for equality in [equality for equality in spec.equalities if equality.type == mujoco.mjtEq.mjEQ_JOINT]:
            if equality.name2 in positions:
                change = positions[equality.name2] - model.joint(equality.name2).qpos0[0]
                follower = model.joint(equality.name1)
                positions[equality.name1] = follower.qpos0[0] + np.polyval(equality.data[4::-1], change)
                spec.delete(equality)
        for name, position in positions.items():
            data.joint(name).qpos[:] = position
        mujoco.mj_kinematics(model, data)
        tendons = [tendon for tendon in spec.tendons if _tendon_joints(tendon) <= positions.keys()]
        removed = {*positions, *(tendon.name for tendon in tendons)}
        for element in (*tendons, *(actuator for actuator in spec.actuators if actuator.target in removed)):
            spec.delete(element)
        for joint in [joint for joint in spec.joints if joint.name in positions]:
            body = model.body(joint.parent.name or int(model.joint(joint.name).bodyid[0]))
            parent = int(body.parentid[0])
            turn = data.xmat[parent].reshape(3, 3).T
            quaternion = np.empty(4)
            mujoco.mju_mat2Quat(quaternion, (turn @ data.xmat[body.id].reshape(3, 3)).ravel())
            place = joint.parent
            place.pos, place.quat = turn @ (data.xpos[body.id] - data.xpos[parent]), quaternion
            place.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            spec.delete(joint)
        spec.copy().compile()
    except (ValueError, KeyError) as error:
        raise ModelError(f"{source}: the locked joints cannot be held still in MuJoCo's model: {error}") from error


def _tendon_joints(tendon: Any) -> set[str]:
    """Return the names of what a tendon acts on: joints, or the sites and shapes on its path."""
    return {wrap.target.name for wrap in tendon.path if wrap.target is not None}


def write_mjcf(text: str, plant: ServoPlant, values: ServoValues) -> str:
    """Return an MJCF with the values at its joints, servos as its actuators, and the delay of the command.

    Offsets of encoders and commands are `<custom>` numbers: no simulator subtracts them. All else stays as it is.
    """
    xml = XmlText(text)
    body_nodes = [node for root in xml.root.children if root.tag == "worldbody" for node in root.walk()]
    joints = {node.attributes.get("name"): node for node in body_nodes if node.tag == "joint"}
    for k, name in enumerate(plant.joints):
        numbers = {"armature": values.armature, "damping": values.damping, "frictionloss": values.frictionloss}
        xml.set(joints[name], {key: _text(array[k]) for key, array in numbers.items()})
    parents = {child.start: node for node in body_nodes for child in node.children}
    for k, name in enumerate(plant.joints):
        if values.mass[k] != 1:
            _set_inertial(xml, parents[joints[name].start], plant, values, k)
    sections = [node for node in xml.root.children if node.tag == "actuator"]
    nodes = {node.attributes.get("joint"): node for section in sections for node in section.children}
    new = []
    for k, name in enumerate(plant.joints):
        if name in nodes:
            xml.replace(nodes[name], _servo(plant, values, k))
        else:
            new.append(_servo(plant, values, k))
    if new and sections:
        xml.insert(sections[-1], *new)
    elif new:
        xml.insert(xml.root, "<actuator>", *(f"  {line}" for line in new), "</actuator>")
    offsets = {"encoder_offset": values.offset, "command_offset": values.command_offset}
    lines = [
        f'  <numeric name={quoteattr(f"{kind}_{name}")} data="{_text(x)}"/>'
        for kind, array in offsets.items()
        for name, x in zip(plant.joints, array, strict=True)
        if array.any()
    ]
    if lines:
        xml.insert(xml.root, "<custom>", *lines, "</custom>")
    return str(xml)


def _text(x: float) -> str:
    return f"{float(x):.9g}"


def _set_inertial(xml: XmlText, body: XmlNode, plant: ServoPlant, values: ServoValues, k: int) -> None:
    model, i = plant.model, plant.bodies[k]
    place, turn = (" ".join(map(_text, array[i])) for array in (model.body_ipos, model.body_iquat))
    inertia = " ".join(_text(x * values.mass[k]) for x in model.body_inertia[i])
    element = (
        f'<inertial pos="{place}" quat="{turn}" mass="{_text(model.body_mass[i] * values.mass[k])}" '
        f'diaginertia="{inertia}"/>'
    )
    inertial = body.find("inertial")
    if inertial is None:
        xml.insert(body, element)
    else:
        xml.replace(inertial, element)


def _servo(plant: ServoPlant, values: ServoValues, k: int) -> str:
    """Return the actuator of a joint, with the gear and the range of commands of the file."""
    actuator, gear = plant.model.actuator(int(plant.actuators[k])), float(plant.gear[k])
    numbers = {"kp": values.kp[k] / gear**2, "kv": values.kd[k] / gear**2, "gear": gear}
    tag = "position"
    if values.takes_torque[k]:
        tag, numbers = ("general", {"gear": gear}) if values.kd[k] else ("motor", {"gear": gear})
    text = f"<{tag} name={quoteattr(actuator.name)} joint={quoteattr(plant.joints[k])} "
    if tag == "general":
        text += f'biastype="affine" biasprm="0 0 {_text(-values.kd[k] / gear**2)}" '
    text += " ".join(f'{key}="{_text(x)}"' for key, x in numbers.items())
    if math.isfinite(values.limit[k]):
        bound = _text(values.limit[k] / abs(gear))
        text += f' forcelimited="true" forcerange="-{bound} {bound}"'
    if actuator.ctrllimited[0]:
        text += f' ctrllimited="true" ctrlrange="{" ".join(map(_text, actuator.ctrlrange))}"'
    if values.delay > 0:
        # MuJoCo's linear delay is the mean of held commands over a step; the buffer has one sample more than it needs
        samples = math.ceil(values.delay / plant.step) + 1
        text += f' delay="{_text(values.delay)}" nsample="{samples}" interp="linear"'
    return text + "/>"


def rollout_difference(
    settings: RobotSettings, text: str, plant: ServoPlant, values: ServoValues, log: ServoLog, source: str
) -> float:
    """Return the largest difference (rad, m) of a rollout of a written MJCF from that of the fitted model.

    The written file gets the commands as they were sent, and its own delay holds them back; the model gets them late.
    """
    written = _spec(settings, text, source)
    lead = math.ceil(values.delay / plant.step) + 2
    count = min(math.ceil((log.t[-1] - log.t[0]) / plant.step), MAX_PROOF_STEPS)
    sent = plant.controls(values, log.commands_at(log.t[0] - lead * plant.step, plant.step, count + lead, 0.0))
    steps = values.delay / plant.step
    full_steps = math.floor(steps + 1e-9)
    delayed = np.vstack([sent[:1]] * (full_steps + 1) + [sent])
    delayed = (1 - (steps - full_steps)) * delayed[1 : len(sent) + 1] + (steps - full_steps) * delayed[: len(sent)]
    start = log.q[0] - values.offset
    paths = [
        _steps(model, plant, control, start, lead)
        for model, control in ((written.compile(), sent), (plant.with_values(values), delayed))
    ]
    return float(np.abs(paths[0] - paths[1]).max())


@ignore_divergence()
def _steps(model: Any, plant: ServoPlant, commands: Array, start: Array, lead: int) -> Array:
    """Return the positions (N, n) after each step from ``start``, once the arm was held there for ``lead`` steps."""
    mujoco = import_mujoco()
    data, path = mujoco.MjData(model), []
    for k, row in enumerate(commands):
        if k <= lead:  # the buffers of the delay fill
            data.qpos[plant.positions] = start
            data.qvel[:] = 0.0
        data.ctrl[plant.actuators] = row
        mujoco.mj_step(model, data)
        path.append(data.qpos[plant.positions].copy())
    return np.array(path[lead:])
