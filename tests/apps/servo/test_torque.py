"""Arms whose commands are torques: known answers in windows, from `init` on, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from dynident.apps.demo.servo_arm import FILE_VALUES, SERVO_JOINTS
from dynident.apps.servo import servo_page
from dynident.apps.servo.fit import split_into_windows, window_residuals
from dynident.apps.servo.start import smooth_servo_log
from dynident.apps.servo.values import FRICTION
from dynident.project.drive_settings import ServoSettings
from tests.apps.servo.arms import ONES, motor_mjcf, plant, torque_recording, values
from tests.apps.servo.made import identified
from tests.cli.commands import run

DELAY, GEAR = 0.012, 2.0


def test_the_values_of_motors_are_found_from_commanded_torques(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "motors.xml").write_text(motor_mjcf(FILE_VALUES, GEAR))
    for name, seed in (("monday", 1), ("tuesday", 2)):
        log = torque_recording(seed)
        head = ",".join(["time", *(f"ctrl_cmd_{x}" for x in SERVO_JOINTS), *(f"pos_{x}" for x in SERVO_JOINTS)])
        rows = np.column_stack([log.t, log.command / [1, 1, GEAR], log.q])
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header=head, comments="")
    drafted = run("init", "motors.xml", "monday.csv", "tuesday.csv", "-o", "motors.yaml")
    assert drafted.exit_code == 0, drafted.output
    assert (
        "column: ctrl_cmd_elbow, gain: 2, unit: N m }, limit: 6.7 }  # a torque"
        in (tmp_path / "motors.yaml").read_text()
    )
    done = run("identify", "motors.yaml", "--out", "out")
    assert done.exit_code == 0, done.output
    assert "good for simulation" in done.output
    numbers = json.loads((tmp_path / "out" / "servo.json").read_text())
    result = {(row["joint"], row["quantity"]): row["value"] for row in numbers["parameters"]}
    assert result[None, "delay"] == pytest.approx(DELAY, abs=3e-4)
    truth = values()
    for k, joint in enumerate(SERVO_JOINTS):
        for quantity in FRICTION:
            assert result[joint, str(quantity)] == pytest.approx(getattr(truth, quantity)[k], rel=0.02)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "robot.xml"))
    assert model.actuator_biastype.tolist() == [0, 0, 0]
    assert model.actuator_gear[2, 0] == GEAR


def test_windows_do_not_see_the_states_that_they_start_from() -> None:
    arm, truth = plant(motor_mjcf(FILE_VALUES)), replace(values(delay=DELAY), kp=0 * ONES)
    motion = smooth_servo_log(torque_recording())
    windows = split_into_windows(arm, motion, truth).windows
    assert windows.starts[1:] == windows.stops[:-1]
    assert windows.stops[-1] == len(motion.log.t)
    exact = np.vstack(window_residuals(arm, motion, windows, truth))
    # a wrong speed at the start moves the arm by mrad, of which next to nothing remains
    hasty = replace(motion, dq=motion.dq + 0.05)
    moved = arm.rollout(truth, motion.log, windows.starts, windows.stops, hasty.speeds)
    assert np.abs(moved[3] - motion.log.q[windows.starts[3] : windows.stops[3]]).max() > 1.5e-3
    assert np.abs(np.vstack(window_residuals(arm, hasty, windows, truth)) - exact).max() < 2e-4


def test_a_commanded_torque_is_not_drawn_as_a_position() -> None:
    angles = identified()
    torques = replace(angles, fit=replace(angles.fit, values=replace(angles.fit.values, kp=0 * ONES)))
    drawn = ['"name":"command"' in servo_page(result) for result in (angles, torques)]
    assert drawn == [True, False]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"kp": 3.0, "ki": 1.0}, "has no actuator with an integral"),
        ({}, "needs `kp` for a command in rad"),
        ({"kp": 3.0, "command": {"column": "x", "unit": "N m"}}, "leave it out for a command in N m"),
    ],
)
def test_what_no_servo_is_has_a_sentence(settings, words) -> None:
    servo = {"command": {"column": "x", "unit": "rad"}} | settings
    with pytest.raises(ValidationError, match=words):
        ServoSettings.model_validate({"kind": "servo", "joints": {"a": servo}})
