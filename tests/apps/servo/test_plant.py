"""The plant: what a delayed command is, and that rollouts are MuJoCo's own steps."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dynident.apps.demo.servo_arm import COUNT, FILE_VALUES, SERVO_JOINTS, TRUE_VALUES, servo_mjcf
from dynident.apps.servo.plant import ServoLog, compile_plant
from dynident.runtime import ModelError
from tests.apps.servo.arms import plant, recording, values


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


def test_values_are_set_as_if_the_file_had_them() -> None:
    compiled = mujoco.MjModel.from_xml_string(servo_mjcf(TRUE_VALUES))
    changed = plant().with_values(values())
    for name in ("dof_armature", "dof_damping", "dof_frictionloss", "dof_invweight0", "actuator_gainprm"):
        np.testing.assert_allclose(getattr(changed, name), getattr(compiled, name), rtol=1e-12)


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
