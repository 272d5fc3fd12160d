"""Draft of the servos of a robot whose logs have commands and positions, and no torque."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dynident.apps.init.match import Match, MovableJoint, columns_beside
from dynident.files.tables import DataTable
from dynident.files.xml_text import SUFFIXES
from dynident.files.yaml_text import yaml_name
from dynident.project.columns import ColumnName, is_commanded
from dynident.project.config import robot_text
from dynident.runtime import DynidentError

if TYPE_CHECKING:
    from dynident.apps.init.column_mapping import ChannelProposal

TORQUE_ADVICE = (
    "commanded torques; if the drives follow them (torque control), name them under `torque` and delete `simulation`"
)
GAIN_QUESTION = (
    "kp (N m/rad) is not in the robot file: give that of the servo, by its data sheet or firmware; `estimate` finds it "
    "by masses and inertias of the file, which must be right"
)


@dataclass(frozen=True)
class ServoProposal:
    """What a robot file says of a joint's servo: kp (None: nothing), kd and limit (None: none), and the actuator.

    That of a motor takes torques, in the ``torque_unit`` of the joint, ``gear`` of them for each it is given.
    """

    kp: float | None = None
    kd: float = 0.0
    limit: float | None = None
    actuator: str = ""
    torque_unit: str = ""
    gear: float = 1.0


def command_columns(table: DataTable, joints: Sequence[MovableJoint], position: Match | None) -> dict[str, str]:
    """Return the columns of commanded positions by joint, for all joints of the ``position``; empty where one lacks."""

    def is_command(name: ColumnName) -> bool:
        is_used = position is not None and name.column in position.columns.values()
        return not is_used and is_commanded(name.column) and name.role in ("", "position")

    return next(iter(columns_beside(table, joints, position, is_command)), {})


def servos_of_file(robot: str, joints: Iterable[MovableJoint]) -> Mapping[str, ServoProposal]:
    """Return the servos that the actuators of an MJCF describe, by joint; of others the limits of the joints."""
    joints = list(joints)
    servos = {joint.name: ServoProposal(limit=joint.limits.effort) for joint in joints}
    units = {joint.name: "N" if joint.kind == "prismatic" else "N m" for joint in joints}
    if Path(robot).suffix.lower() not in SUFFIXES:
        return servos
    try:
        import mujoco

        text = robot_text(Path(robot))
        actuators = mujoco.MjSpec.from_string(text).actuators if "<actuator" in text else ()
    except (ImportError, ValueError, DynidentError):  # said where the robot is simulated
        return servos
    for actuator in actuators:
        if actuator.target in servos and actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT:
            servos[actuator.target] = _servo(actuator, servos[actuator.target].limit, units[actuator.target])
    return servos


def _servo(actuator: object, effort: float | None, torque_unit: str) -> ServoProposal:
    """Return what an actuator says, at the joint behind its gear."""
    gear, name = abs(float(actuator.gear[0])) or 1.0, str(actuator.name)  # type: ignore[attr-defined]
    gain, bias = float(actuator.gainprm[0]), actuator.biasprm  # type: ignore[attr-defined]
    # a range is a limit where the file does not say otherwise
    low, high = map(float, actuator.forcerange)  # type: ignore[attr-defined]
    limit = gear * min(abs(low), abs(high)) if low < high and int(actuator.forcelimited) else effort  # type: ignore[attr-defined]
    if gain == 1 and not int(actuator.biastype) and not int(actuator.dyntype):  # type: ignore[attr-defined]
        turns = float(actuator.gear[0]) or 1.0  # type: ignore[attr-defined]
        return ServoProposal(None, 0.0, limit, name, torque_unit, turns)
    if not math.isclose(gain, -float(bias[1])) or not gain:  # no position servo
        return ServoProposal(limit=limit, actuator=name)
    # a negative kv stands for a damping ratio, which is resolved by the masses
    return ServoProposal(gain * gear**2, max(-float(bias[2]), 0.0) * gear**2, limit, name)


def servo_section(
    servos: Mapping[str, ServoProposal], commands: Mapping[str, ChannelProposal]
) -> tuple[list[str], list[str]]:
    """Return the lines of `simulation` in a draft, and the joints whose kp has to be asked for."""
    lines = [
        "",
        "simulation:  # no torque was recorded: the servos are simulated in MuJoCo, driven by the commands",
        "  kind: servo",
        "  commands: estimate  # held until the next one, or interpolated",
        "  delay: estimate  # or s, from a command to the position that answers it",
        "  joints:",
    ]
    for name, channel in commands.items():
        servo, wraps = servos[name], f" wraps: {channel.wraps!r}," if channel.wraps else ""
        column, reason = yaml_name(str(channel.column)), ""
        if servo.torque_unit:
            gain = f" gain: {servo.gear:.6g}," if servo.gear != 1 else ""
            text, reason = f"command: {{ column: {column},{gain} unit: {servo.torque_unit} }}", "a torque, "
        else:
            text = f"command: {{ column: {column},{wraps} unit: {channel.unit} }}, "
            text += f"kp: {'estimate' if servo.kp is None else f'{servo.kp:.6g}'}"
        text += f", kd: {servo.kd:.6g}" if servo.kd else ""
        text += f", limit: {servo.limit:.6g}" if servo.limit else ""
        if servo.actuator and (servo.torque_unit or servo.kp is not None):
            reason = f"  # {reason}of the actuator {servo.actuator!r}"
        lines.append(f"    {yaml_name(name)}: {{ {text} }}{reason}")
    return lines, [name for name in commands if servos[name].kp is None and not servos[name].torque_unit]
