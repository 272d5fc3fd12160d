"""Backlash: found with its size on arms that have it, on either side of the encoder, and on no right arm."""

from __future__ import annotations

import json
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from dynident.apps.demo.servo_arm import (
    COUNT,
    FILE_VALUES,
    LOG_EVERY,
    SERVO_JOINTS,
    TRUE_DELAY,
    TRUE_VALUES,
    servo_files,
    servo_mjcf,
    servo_recording,
)
from dynident.apps.servo.backlash import Backlash, find_backlash
from dynident.apps.servo.fit import fit_values
from dynident.apps.servo.judge import position_noise
from dynident.apps.servo.plant import ServoLog
from dynident.apps.servo.robot import load_plant
from dynident.apps.servo.start import smooth_servo_log
from tests.apps.servo.arms import ENTRIES, SETTINGS, plant, recording, values
from tests.cli.commands import succeed

FINE_STEP, SIZE = 1e-3, 0.02  # s, rad


def slack_recording(seed: int, k: int, output: bool, duration: float = 4.0, stiffness: float = 0.0) -> ServoLog:
    """The demo's arm with a gap or spring behind the motor of joint k, simulated in finer steps than the fit has."""
    t, command, _ = servo_recording(seed, duration)
    gap = f'<joint name="gap" axis="{"0 0 1" if k == 0 else "0 1 0"}" range="{-SIZE / 2} {SIZE / 2}" limited="true" '
    gap += 'solreflimit="0.002 1" solimplimit="0.99 0.999 0.001"/>'
    if stiffness:
        gap = f'<joint name="gap" axis="{"0 0 1" if k == 0 else "0 1 0"}" stiffness="{stiffness}" damping="0.02"/>'
    text = servo_mjcf(TRUE_VALUES).replace('timestep="0.002"', f'timestep="{FINE_STEP}"')
    head, name, tail = text.partition(f'name="{SERVO_JOINTS[k]}" axis')
    end = tail.index("/>") + 2
    model = mujoco.MjModel.from_xml_string(head + name + tail[:end] + gap + tail[end:])
    data, place = mujoco.MjData(model), model.joint("gap").qposadr[0]
    motors = [model.joint(x).qposadr[0] for x in SERVO_JOINTS]
    data.qpos[motors] = command[0]
    every, delayed = LOG_EVERY * 2, round(TRUE_DELAY / FINE_STEP)
    q = np.empty(command.shape)
    for i in range(len(t) * every):
        seen = data.qpos[motors]
        seen[k] += output * data.qpos[place]
        if i % every == 0:
            q[i // every] = seen
        data.ctrl[:] = command[max(i - delayed, 0) // every] - (seen - data.qpos[motors])
        mujoco.mj_step(model, data)
    return ServoLog("slack", t, np.round(q / COUNT) * COUNT, t, command)


def gaps_of(log: ServoLog) -> tuple[Backlash, ...]:
    """What is found in a recording."""
    motion = smooth_servo_log(log)
    fit = fit_values(plant(), [motion], values(), ENTRIES)

    def load(ks):
        return load_plant(SETTINGS, servo_mjcf(FILE_VALUES), SERVO_JOINTS, "x", [SERVO_JOINTS[k] for k in ks])

    return find_backlash(load, [motion], fit, position_noise(log.q))


@pytest.mark.parametrize(("k", "output"), [(1, True), (0, False)])
def test_a_gap_is_found_with_joint_size_and_side(k: int, output: bool) -> None:
    (gap,) = gaps_of(slack_recording(1, k, output))
    assert (gap.k, gap.output) == (k, output)
    assert gap.size == pytest.approx(SIZE, rel=0.2)


def noisy(log: ServoLog) -> ServoLog:
    noise = 2e-3 * np.random.default_rng(1).standard_normal(log.q.shape)
    return ServoLog("noisy", log.t, log.q + noise, log.t, log.command)


@pytest.mark.parametrize(
    "record",
    [
        lambda: recording(1),
        lambda: noisy(recording(3)),
        lambda: slack_recording(1, 1, output=False, stiffness=15.0),
    ],
    ids=["right", "noise", "a spring behind a motor"],
)
def test_of_other_arms_no_gap_is_said(record: Callable[[], ServoLog]) -> None:
    assert gaps_of(record()) == ()


def test_backlash_is_in_verdict_warnings_and_numbers(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    _, *logs = servo_files(tmp_path, 4.0)
    for seed, path in enumerate(logs, start=1):
        log = slack_recording(seed, 2, output=True)
        rows = np.column_stack([log.t, log.command, log.q])
        np.savetxt(path, rows, delimiter=",", header=path.read_text().splitlines()[0], comments="")
    succeed("init", "servos.xml", "monday.csv", "tuesday.csv", "-o", "arm.yaml")
    drafted = (tmp_path / "arm.yaml").read_text()
    (tmp_path / "arm.yaml").write_text(drafted.replace("commands: estimate", "commands: held"))
    words = " ".join(succeed("identify", "arm.yaml", "--out", "out").output.split())
    assert "joint 'elbow' has about" in words
    assert "good for simulation" not in words
    assert "Backlash of elbow is not in the model" in words
    numbers = json.loads((tmp_path / "out" / "servo.json").read_text())
    (gap,) = numbers["backlash"]
    assert (gap["joint"], gap["at"]) == ("elbow", "output")
    assert gap["size"] == pytest.approx(SIZE, rel=0.2)
