"""The configuration that reads recordings of servos which are still to be made."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dynident.apps.init.column_mapping import ChannelProposal
from dynident.apps.init.match import read_joints
from dynident.apps.init.servo_draft import GAIN_QUESTION, servo_section, servos_of_file
from dynident.files.opener import relative
from dynident.files.yaml_text import yaml_name
from dynident.models import Joint


def servo_config(robot: str, joints: Sequence[Joint], folder: Path) -> tuple[str, list[str]]:
    """Return the configuration, with columns cmd_JOINT and pos_JOINT, and what is to be filled in.

    The robot file is named relative to the ``folder``.
    """
    names = {joint.name: yaml_name(joint.name) for joint in joints}
    commands = {joint.name: ChannelProposal(f"cmd_{joint.name}", joint.unit) for joint in joints}
    movable = [joint for joint in read_joints(robot) if joint.name in names]
    section, asked = servo_section(servos_of_file(robot, movable), commands)
    columns = {joint.name: yaml_name(f"pos_{joint.name}") for joint in joints}
    lines = [
        "# For `dynident check` and `dynident identify`, once the motions of this folder are recorded.",
        f"model: {{ file: {yaml_name(relative(Path(robot), folder))} }}",
        "time: { column: time, unit: s }",
        "position:",
        *(f"  {names[x.name]}: {{ column: {columns[x.name]}, unit: {x.unit} }}" for x in joints),
        *section,
        "train: [{ file: motion_recorded.csv }]",
        "validation: [{ file: validation_recorded.csv }]",
    ]
    return "\n".join(lines) + "\n", [f"{name}: {GAIN_QUESTION}" for name in asked]
