"""Commands by name, and servos by the actuators of an MJCF."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.apps.init.match import Match, MovableJoint
from dynident.apps.init.servo_draft import ServoProposal, command_columns, servos_of_file
from dynident.files.tables import DataTable
from dynident.project.columns import ColumnFamily

JOINTS = [MovableJoint("pan", "revolute"), MovableJoint("lift", "revolute")]
SPELLINGS = {
    "cmd_pan cmd_lift": ("pos_pan", "pos_lift"),
    "action.pan.pos action.lift.pos": ("observation.state.pan.pos", "observation.state.lift.pos"),
    "q_des1 q_des2": ("q1", "q2"),
    "target_position_pan target_position_lift": ("position_pan", "position_lift"),
    "goalLift goalPan": ("pan", "lift"),
}


@pytest.mark.parametrize(("commands", "positions"), SPELLINGS.items())
def test_commands_are_found_by_name(commands: str, positions: tuple[str, str]) -> None:
    names = [*positions, *commands.split(), "dq_cmd_pan", "dq_cmd_lift"]
    table = DataTable({name: np.arange(5.0) for name in names}, {}, "log")
    match = Match(ColumnFamily("position", 0, {}), dict(zip(("pan", "lift"), positions, strict=True)), "")
    result = command_columns(table, JOINTS, match)
    assert set(result.values()) == set(commands.split())
    assert list(result) == (["lift", "pan"] if commands.startswith("goalLift") else ["pan", "lift"])


def test_commands_of_some_joints_are_no_servo_log() -> None:
    table = DataTable({name: np.arange(5.0) for name in ("pos_pan", "pos_lift", "cmd_pan")}, {}, "log")
    match = Match(ColumnFamily("position", 0, {}), {"pan": "pos_pan", "lift": "pos_lift"}, "")
    assert command_columns(table, JOINTS, match) == {}
    assert command_columns(table, JOINTS, None) == {}


def test_servos_are_those_of_the_actuators(tmp_path) -> None:
    (tmp_path / "arm.xml").write_text(
        '<mujoco><default><position kp="5" kv="0.5"/></default><worldbody><body><joint name="pan"/><geom size="0.1"/>'
        '<body><joint name="lift"/><geom size="0.1"/></body></body></worldbody><actuator>'
        '<position name="p" joint="pan" gear="2" forcerange="-3 4"/><motor joint="lift"/></actuator></mujoco>'
    )
    servos = servos_of_file(str(tmp_path / "arm.xml"), JOINTS)
    assert servos == {"pan": ServoProposal(20.0, 2.0, 6.0, "p"), "lift": ServoProposal(torque_unit="N m")}
