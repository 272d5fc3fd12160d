"""Files of servo arms, the plant that is made of them, and that what is written moves as what was fitted."""

from dataclasses import replace
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
import pytest

from dynident.apps.demo.servo_arm import COUNT, FILE_VALUES, SERVO_JOINTS, TRUE_VALUES, servo_mjcf
from dynident.apps.servo.plant import ServoLog, compile_plant
from dynident.apps.servo.robot import load_plant, mjcf_text, rollout_difference, write_mjcf
from dynident.project.settings import RobotSettings
from dynident.runtime import ModelError
from tests.apps.servo.arms import SETTINGS, plant, recording, values

URDF = """<robot name="two"><link name="a"/><link name="b"><inertial><origin xyz="0 0 0.1"/><mass value="0.3"/>
<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial>
<visual><geometry><mesh filename="missing.stl"/></geometry></visual></link>
<joint name="hinge" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="2" velocity="5"/></joint></robot>
"""


INERTIAL = '<inertial pos="0.06 0 0.01" mass="0.14" diaginertia="9e-5 9e-5 9e-5"/>'


@pytest.mark.parametrize(("gear", "body"), [(1.0, INERTIAL), (-4.0, '<geom size="0.03" pos="0.06 0 0.01"/>')])
def test_a_written_file_moves_as_the_fit(gear: float, body: str) -> None:
    text = servo_mjcf(FILE_VALUES).replace('joint="elbow" kp', f'joint="elbow" gear="{gear}" kp')
    text = text.replace(INERTIAL, body)
    arm = plant(text)
    truth = replace(
        values(),
        offset=np.array([0.0, 0.02, 0.0]),
        command_offset=np.array([0.01, 0.0, 0.0]),
        mass=np.array([1.0, 1.0, 1.2]),
    )
    written = write_mjcf(text, arm, truth)
    assert rollout_difference(SETTINGS, written, arm, truth, recording(duration=3.0), "x") < 1e-9
    model = mujoco.MjModel.from_xml_string(written)
    assert model.body("elbow_link").mass == pytest.approx(1.2 * arm.model.body("elbow_link").mass)
    assert model.actuator_gainprm[2, 0] * gear**2 == pytest.approx(truth.kp[2])
    assert model.actuator_delay == pytest.approx(truth.delay)
    assert model.numeric("encoder_offset_shoulder").data == pytest.approx(0.02)


def test_names_of_the_file_are_text() -> None:
    """A name that would be an element of its own stays a name, and the file is read again."""
    hostile = 'el"/><key name="x'
    text = servo_mjcf(FILE_VALUES).replace('"elbow"', quoteattr(hostile))
    joints = [hostile if name == "elbow" else name for name in SERVO_JOINTS]
    arm = load_plant(SETTINGS, text, joints, "servos.xml")
    written = write_mjcf(text, arm, replace(values(), offset=np.array([0.0, 0.0, 0.02])))
    model = mujoco.MjModel.from_xml_string(written)
    assert model.joint(hostile).id == model.actuator(hostile).trnid[0]
    assert model.numeric(f"encoder_offset_{hostile}").data == pytest.approx(0.02)
    assert model.nkey == 0


def test_another_file_is_told_apart() -> None:
    arm, truth = plant(), values()
    written = write_mjcf(servo_mjcf(FILE_VALUES), arm, replace(truth, delay=0.0))
    assert rollout_difference(SETTINGS, written, arm, truth, recording(duration=3.0), "x") > 1e-4


def test_a_locked_joint_stands_where_it_is_held() -> None:
    settings = RobotSettings.model_validate({"file": "servos.xml", "lock": {"elbow": 0.4}})
    arm = load_plant(settings, servo_mjcf(TRUE_VALUES), SERVO_JOINTS[:2], "servos.xml")
    full = mujoco.MjModel.from_xml_string(servo_mjcf(TRUE_VALUES))
    data, held = mujoco.MjData(full), mujoco.MjData(arm.model)
    data.qpos[:] = [0.3, -0.5, 0.4]
    held.qpos[:] = [0.3, -0.5]
    for model, state in ((full, data), (arm.model, held)):
        mujoco.mj_kinematics(model, state)
    np.testing.assert_allclose(held.xipos, data.xipos, atol=1e-12)
    assert arm.model.nu == 2


FINGERS = """
<body name="left" pos="0 0.02 0"><joint name="left" type="slide" axis="0 1 0"/><inertial pos="0 0 0.01" mass="0.02"
  diaginertia="1e-5 1e-5 1e-5"/></body>
<body name="right" pos="0 -0.02 0"><joint name="right" type="slide" axis="0 -1 0"/><inertial pos="0 0 0.01" mass="0.02"
  diaginertia="1e-5 1e-5 1e-5"/></body>"""
GRIPPER = """
<equality><joint joint1="left" joint2="right" polycoef="0.001 2 0 0 0"/></equality>
<tendon><fixed name="grip"><joint joint="left" coef="0.5"/><joint joint="right" coef="0.5"/></fixed></tendon>
<sensor><jointpos joint="left"/></sensor>
<keyframe><key name="home" qpos="0 0 0 0.01 0.01" ctrl="0 0 0 0.01"/></keyframe>"""


def test_a_locked_gripper_takes_along_what_follows_and_drives_it() -> None:
    text = servo_mjcf(TRUE_VALUES).replace("</body></body></body>", f"{FINGERS}</body></body></body>")
    text = text.replace("</actuator>", '<position tendon="grip" kp="10"/></actuator>')
    settings = RobotSettings.model_validate({"file": "servos.xml", "lock": {"right": 0.01}})
    arm = load_plant(settings, text.replace("</mujoco>", f"{GRIPPER}</mujoco>"), SERVO_JOINTS, "servos.xml")
    assert (arm.model.nv, arm.model.nu, arm.model.neq) == (3, 3, 0)
    assert arm.model.body("right").pos == pytest.approx([0.0, -0.03, 0.0])
    assert arm.model.body("left").pos == pytest.approx([0.0, 0.02 + 0.001 + 2 * 0.01, 0.0])


def test_a_urdf_becomes_an_mjcf_with_servos(tmp_path) -> None:
    (tmp_path / "two.urdf").write_text(URDF)
    text = mjcf_text(tmp_path / "two.urdf")
    arm = load_plant(SETTINGS, text, ["hinge"], "two.urdf")
    truth = values()
    arrays = {key: entries[:1] for key, entries in vars(truth).items() if key != "delay"}
    case = replace(truth, **arrays)
    model = mujoco.MjModel.from_xml_string(write_mjcf(text, arm, case))
    assert model.actuator_gainprm[0, 0] == pytest.approx(17.8)
    assert model.dof_armature[0] == pytest.approx(0.028)


def test_what_mujoco_refuses_is_said() -> None:
    with pytest.raises(ModelError, match=r"x\.xml: MuJoCo cannot read it"):
        load_plant(SETTINGS, "<mujoco><worldbody><nonsense/></worldbody></mujoco>", ["a"], "x.xml")


@pytest.mark.parametrize("held", [True, False])
def test_a_delayed_command_is_its_mean_over_the_step(held: bool) -> None:
    t = np.array([0.0, 0.1, 0.2])
    log = ServoLog("x", t, np.zeros((3, 1)), t, np.array([[1.0], [3.0], [7.0]]), held)
    # from 0.09 to 0.13 s: a quarter of it before the second command where commands are held
    first, delayed = (log.commands_at(0.09 + delay, 0.04, 1, delay)[0, 0] for delay in (0.0, 0.05))
    assert first == pytest.approx(0.25 * 1 + 0.75 * 3 if held else np.interp(0.11, t, [1.0, 3.0, 7.0]))
    assert delayed == pytest.approx(first)
    assert log.commands_at(-1.0, 0.5, 1, 0.0)[0, 0] == 1.0  # before the first command


def test_the_true_arm_moves_as_it_was_recorded() -> None:
    log = recording()
    simulated = plant().rollout(values(), log)[0]
    assert np.abs(simulated - log.q)[50:].max() < 0.55 * COUNT


def test_what_cannot_be_a_servo_is_named() -> None:
    spec = mujoco.MjSpec.from_string(servo_mjcf(FILE_VALUES))
    with pytest.raises(ModelError, match="cannot compile it"):
        compile_plant(spec, ("base", "wing"), "servos.xml")
    spec = mujoco.MjSpec.from_string(servo_mjcf(FILE_VALUES).replace('joint="elbow" kp', 'joint="base" kp'))
    with pytest.raises(ModelError, match="'base' has two actuators"):
        compile_plant(spec, SERVO_JOINTS, "servos.xml")


def test_a_simulation_that_diverges_prints_and_writes_nothing(tmp_path, monkeypatch, capfd) -> None:
    monkeypatch.chdir(tmp_path)
    wild = replace(values(kp=1e9), limit=np.full(3, np.inf))
    plant().rollout(wild, recording())
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir())
