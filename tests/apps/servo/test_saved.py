"""A saved result of servos: its model is MuJoCo's, and other simulators get its values."""

import json

import mujoco
import numpy as np
import pytest

from dynident.apps.demo.servo_arm import KP, LIMIT, SERVO_JOINTS
from dynident.apps.servo.saved import SavedServos, load_servo_result
from dynident.project.export.simulators import read_literals
from tests.cli.commands import refuse, succeed

CHANGES = {("mass", "shoulder"): 1.3, ("mass", "elbow"): 0.7, ("offset", "base"): 0.02, ("offset", "elbow"): 0.01}


@pytest.fixture
def saved(folder) -> SavedServos:
    """The result of the demo, with masses and offsets that were fitted, too."""
    result = json.loads((folder / "servos" / "servo.json").read_text())
    for (quantity, joint), value in CHANGES.items():
        result["parameters"].append({"quantity": quantity, "joint": joint, "value": value, "std": 0.01})
    (folder / "changed.json").write_text(json.dumps(result))
    return load_servo_result(folder / "changed.json")


def test_the_model_for_exports_has_the_torques_of_mujoco(saved) -> None:
    identified, values = saved.identified, saved.values
    model = saved.arm.plant.with_values(values)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    states = rng.uniform(-2.0, 2.0, (3, 20, len(SERVO_JOINTS)))
    torques = identified.model.torque(*states, identified.value) - values.frictionloss * np.sign(states[1])
    for k, (q, dq, ddq) in enumerate(zip(*states, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(data.qfrc_inverse, torques[k], rtol=1e-9, atol=1e-9)


def test_isaac_lab_gets_what_was_found(saved, folder) -> None:
    done = succeed("export", "changed.json", "--format", "isaac", "--out", "arm_isaac.py")
    assert "Not in the file: offset of base = 0.0200 rad" in done.output
    assert "offset of elbow = 0.0100 rad" in done.output
    literals, values = read_literals((folder / "arm_isaac.py").read_text()), saved.values
    columns = {
        "ARMATURE": values.armature, "FRICTION": values.frictionloss, "VISCOUS_FRICTION": values.damping,
        "STIFFNESS": [KP] * 3, "EFFORT_LIMIT": [LIMIT] * 3, "DELAY": [values.delay] * 3,
    }  # fmt: skip
    for name, expected in columns.items():
        assert literals[name] == pytest.approx(dict(zip(SERVO_JOINTS, expected, strict=True)))
    assert literals["RANGES"]["armature"]["elbow"][0] < values.armature[2]


@pytest.mark.parametrize("kind", ["urdf", "drake", "pinocchio", "yaml"])
def test_other_formats_are_written_and_compared(kind: str, folder) -> None:
    done = succeed("export", "servos/servo.json", "--format", kind, "--out", f"arm.{kind}")
    assert "Reloaded: the largest difference" in done.output
    refuse("export", "servos/servo.json", "--format", "mjcf", "--out", "arm.xml", says="is servos/robot.xml")
