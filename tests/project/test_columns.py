"""What names of columns say."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.project.columns import families, read_name, stated_unit, tokens

JOINTS = ("joint_1", "joint_2", "joint_10", "elbow")
NAMES = {  # role, joint, number, unit, rank
    "q1": ("position", None, 1, None, 0),
    "pos[0]": ("position", None, 0, None, 0),
    "positions[3]": ("position", None, 3, None, 0),
    "joint_2_position": ("position", "joint_2", None, None, 0),
    "joint_10.effort": ("torque", "joint_10", None, None, 0),
    "joint_10_eff": ("torque", "joint_10", None, None, 0),
    "elbow.position": ("position", "elbow", None, None, 0),
    "Elbow angle [°]": ("position", "elbow", None, "deg", 0),
    "Achse2 Winkel [°]": ("position", None, 2, "deg", 0),
    "Drehmoment_2_ist": ("torque", None, 2, None, 1),
    "Achse2 Strom [mA]": ("current", None, 2, "mA", 0),
    "Zeit [ms]": ("time", None, None, "ms", 0),
    "A3 [°]": ("position", None, 3, "deg", 0),
    "motor_current_3": ("current", None, 3, None, 0),
    "M3 load (%)": ("current", None, 3, "%", 0),
    "Auslastung_3_%": ("current", None, 3, "%", 0),
    "battery 3 [%]": ("", None, 3, None, 0),
    "cur_mA_3": ("current", None, 3, "mA", 0),
    "tau_meas1": ("torque", None, 1, None, 1),
    "tauMeas[1]": ("torque", None, 1, None, 1),
    "Torque (N m) 2": ("torque", None, 2, "N m", 0),
    "pos_filt1": ("position", None, 1, None, -1),
    "pos_des1": ("position", None, 1, None, -2),
    "q_d[0]": ("position", None, 0, None, -2),
    "tau_ext[0]": ("torque", None, 0, None, -2),
    "/command/elbow.effort": ("torque", "elbow", None, None, -2),
    "enc_m2": ("position", None, 2, None, 0),
    "theta_m_2": ("position", None, 2, None, 0),
    "pos_2_m": ("position", None, 2, "m", 0),
    "q_dot_2": ("velocity", None, 2, None, 0),
    "theta_ddot_2": ("acceleration", None, 2, None, 0),
    "tau_dot_2": ("velocity", None, 2, None, 0),
    "eePos_1": ("position", None, 1, None, -2),
    "computed_torque_2": ("torque", None, 2, None, -1),
    "dq_2": ("velocity", None, 2, None, 0),
    "ddq2": ("acceleration", None, 2, None, 0),
    "Achse A3 Ist [Grad]": ("position", None, 3, "deg", 1),
    "current_position_1": ("position", None, 1, None, 0),
    "actual_current_as_torque_0": ("torque", None, 0, None, 1),
    "torque_current_2": ("current", None, 2, None, 0),
    "actual_TCP_force_0": ("torque", None, 0, None, -2),
    "J1_deg": ("position", None, 1, "deg", 0),
    "T2 [Nm]": ("torque", None, 2, "N m", 0),
    "T2 [N·mm]": ("torque", None, 2, "N mm", 0),
    "i3": ("current", None, 3, None, 0),
    "time_ms": ("time", None, None, "ms", 0),
    "Time (min)": ("time", None, None, "min", 0),
    "Time [s]": ("time", None, None, "s", 0),
    "t": ("time", None, None, None, 0),
    "ts": ("time", None, None, None, 0),
    "qpos[2]": ("position", None, 2, None, 0),
    "qvel[2]": ("velocity", None, 2, None, 0),
    "qfrc_actuator[2]": ("torque", None, 2, None, 0),
    "qfrc_bias[2]": ("torque", None, 2, None, -2),
    "$AXIS_ACT[2]": ("position", None, 2, None, 1),
    "Motorstrom3": ("current", None, 3, None, 0),
    "Istwinkel2 [Grad]": ("position", None, 2, "deg", 1),
    "Sollwinkel2": ("position", None, 2, None, -2),
    "jointtorque4": ("torque", None, 4, None, 0),
    "关节1角度 [mrad]": ("position", None, 1, "mrad", 0),
    "指令位置2": ("position", None, 2, None, -2),
    "实际电流2": ("current", None, 2, None, 1),
    "加速度2": ("acceleration", None, 2, None, 0),
    "时间": ("time", None, None, None, 0),
    "pos_2 [0.01 deg]": ("position", None, 2, "0.01 deg", 0),
    "Istposition A2 [1e-4 Grad]": ("position", None, 2, "1e-4 deg", 1),
    "Winkel_2 (0,01 Grad)": ("position", None, 2, "0.01 deg", 0),
    "trq_2 [0.1%]": ("torque", None, 2, None, 0),
    "vir": ("", None, None, None, 0),
    "J2 Dstb Trq (Nm)": ("torque", None, 2, "N m", -2),
    "log.I_mot.Data[2]": ("current", None, 2, None, 0),
    "axis2.current_control.Iq_measured": ("current", None, 2, None, 1),
    "axis2.current_control.Iq": ("current", None, 2, None, -2),
    "axis 2 pos [rad] motor side": ("position", None, 2, "rad", 0),
    "FBPos_2": ("position", None, 2, None, 1),
    "第2軸 電流値 [A]": ("current", None, 2, "A", 0),
}


@pytest.mark.parametrize("name", NAMES)
def test_names_are_read(name):
    test_name = read_name(name, JOINTS)
    assert (test_name.role, test_name.joint, test_name.number, test_name.unit, test_name.rank) == NAMES[name]


ARM, LETTERS = ("ur_elbow_joint", "ur_wrist_1_joint", "ur_x_joint"), ("joint_1_s", "joint_6_t")


@pytest.mark.parametrize(
    ("column", "joints", "joint", "role"),
    [("elbow_pos", ARM, "ur_elbow_joint", "position"), ("tau wrist_1", ARM, "ur_wrist_1_joint", "torque"),
     ("pos_1", ARM, None, "position"), ("x_force", ARM, None, "torque"), ("t", LETTERS, None, "time"),
     ("S axis pulses", LETTERS, "joint_1_s", "position"), ("Trq_T [%]", LETTERS, "joint_6_t", "torque")],
)  # fmt: skip
def test_words_that_all_joints_share_may_be_missing(column, joints, joint, role):
    name = read_name(column, joints)
    assert (name.joint, name.role) == (joint, role)


@pytest.mark.parametrize(
    ("column", "unit"), [("pos 4 [1e-4 Grad]", "1e-4 Grad"), ("t_1 [0.1 %]", "0.1 %"), ("q[elbow]", ""), ("q[4]", "")]
)
def test_a_unit_in_brackets_is_stated_whatever_the_joints_are_called(column, unit):
    assert stated_unit(column, ("elbow", "axis4", "joint_1")) == unit


@pytest.mark.parametrize(
    "names",
    [
        ("Axis 1 Pos [deg]", "Axis 2 Pos [deg]", "Axis 3 Pos [mm]"),
        ("joint_1 Torque [Nm]", "joint_2 Torque [Nm]", "elbow Force [N]"),
    ],
)
def test_a_joint_that_slides_belongs_to_those_that_turn(names):
    (result,) = families(names, JOINTS)
    assert tuple(result.columns.values()) == names
    assert result.units[names[0]] != result.units[names[2]]


def test_two_spellings_of_one_quantity_are_two_families():
    names = ["q1", "q2", "pos1", "pos2", "x_deg_1", "x_rad_2"]
    assert [tuple(family.columns.values()) for family in families(names, JOINTS)] == [
        ("q1", "q2"),
        ("pos1", "pos2"),
        ("x_deg_1",),
        ("x_rad_2",),
    ]


@given(st.lists(st.text(max_size=20), max_size=5), st.lists(st.text(max_size=8), max_size=3))
def test_any_names_are_read(columns, joints):
    for column in columns:
        tokens(column)
    for family in families(columns, joints):
        assert set(family.columns.values()) <= set(columns)
