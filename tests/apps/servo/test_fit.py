"""The fit: known answers with their errors, a wrong kp, an unknown one, a servo that diverges, and backlash."""

import json
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dynident.apps.demo.servo_arm import (
    COUNT,
    FILE_VALUES,
    KP,
    LIMIT,
    LOG_EVERY,
    SERVO_JOINTS,
    TRUE_DELAY,
    TRUE_VALUES,
    servo_files,
    servo_mjcf,
    servo_recording,
)
from dynident.apps.servo.backlash import Backlash, find_backlash
from dynident.apps.servo.fit import fit_values, residuals, sensitivity, suspect_entries
from dynident.apps.servo.judge import ServoUse, position_noise, roll_out
from dynident.apps.servo.plant import ServoLog
from dynident.apps.servo.robot import load_plant
from dynident.apps.servo.run import choose_fit
from dynident.apps.servo.start import smooth_servo_log, start_values
from dynident.apps.servo.values import Entry, Quantity, ServoValues
from dynident.project.drive_settings import ServoSettings
from dynident.runtime import InputError, ModelError
from tests.apps.servo.arms import ENTRIES, SETTINGS, plant, recording, values
from tests.cli.commands import succeed


@pytest.fixture(scope="module")
def motion():
    return smooth_servo_log(recording())


def test_values_and_delay_are_found_within_their_errors(motion) -> None:
    start = start_values(plant(), [motion], values(FILE_VALUES, delay=0.0), free_delay=True)
    assert abs(start.delay - TRUE_DELAY) < 0.004
    fit = fit_values(plant(), [motion], start, ENTRIES)
    truth = values()
    scores = [(fit.values.entry(e) - truth.entry(e)) / s for e, s in zip(fit.entries, fit.std, strict=True)]
    assert fit.converged
    assert fit.undetermined == ()
    assert np.abs(scores).max() < 4
    assert abs(fit.values.delay - TRUE_DELAY) < 1e-4
    for entry in ENTRIES[:6]:
        assert fit.values.entry(entry) == pytest.approx(truth.entry(entry), rel=0.01)
    assert suspect_entries(plant(), [motion], fit) == {}
    held_out = smooth_servo_log(recording(2))
    rollout = roll_out(plant(), held_out, "validation", fit.values, values(FILE_VALUES))
    assert rollout.use is ServoUse.GOOD
    assert (rollout.error < 1.3 * 2 * np.pi / 4096 / np.sqrt(12)).all()
    assert (rollout.nominal_error > 10 * rollout.error).all()


def test_the_slope_by_the_delay_is_that_to_both_sides() -> None:
    # commands in steps at 30 Hz pass from one time step to the next: a slope to one side alone stops a search
    t, delay, change = np.arange(180) / 30.0, Entry(Quantity.DELAY, 0), 2e-4
    command = np.round(0.3 * np.sin(np.outer(t, (5.0, 3.0, 4.0))) + 0.2 * (np.floor(t[:, None] / 2) % 2), 2)
    motion = smooth_servo_log(ServoLog("30 Hz", t, 0 * command, t, command))
    base, *sides = (residuals(plant(), [motion], values(delay=TRUE_DELAY + x)) for x in (0.0, change, -change))
    slope = sensitivity(plant(), [motion], values(), [delay], base)[..., 0]
    misses = [np.linalg.norm(side - base - x * slope) for side, x in zip(sides, (change, -change), strict=True)]
    assert misses[0] == pytest.approx(misses[1], rel=0.25)


def test_an_unknown_kp_starts_from_gravity(motion) -> None:
    unknown = replace(values(FILE_VALUES, delay=0.0), kp=np.full(3, np.nan))
    start = start_values(plant(), [motion], unknown, free_delay=True)
    assert start.kp == pytest.approx(KP, rel=0.3)


def test_a_rest_and_a_simulation_that_diverges_are_said(motion) -> None:
    log = recording()
    still = smooth_servo_log(replace(log, q=0 * log.q))
    with pytest.raises(InputError, match="joint 'base' moves faster than"):
        start_values(plant(), [still], values(), free_delay=False)
    short = replace(log, t=log.t[:30], q=log.q[:30])
    with pytest.raises(InputError, match=r"has 30 samples in 0.29 s"):
        smooth_servo_log(short)
    with pytest.raises(ModelError, match="diverges"):
        fit_values(plant(), [motion], replace(values(), kp=np.full(3, np.nan)), ENTRIES)


def settings_of(kp: float = KP, **changes: object) -> ServoSettings:
    """The servos of the arm, that of the shoulder with this kp, and changes."""
    servo = {"command": {"column": "x", "unit": "rad"}, "kp": KP, "limit": LIMIT}
    joints = dict.fromkeys(SERVO_JOINTS, servo) | {"shoulder": servo | {"kp": kp}}
    return ServoSettings.model_validate({"kind": "servo", "joints": joints, **changes})


def test_a_wrong_kp_and_a_command_whose_zero_is_another_are_found_and_fitted() -> None:
    log = recording(duration=5.0)
    shifted = smooth_servo_log(replace(log, q=log.q + np.array([0.0, 0.0, 0.02])))
    wrong = replace(values(), kp=np.array([1.0, 1.2, 1.0]) * KP)
    _, fit, suspects = choose_fit(plant(), [shifted], wrong, settings_of(1.2 * KP, commands="held"))
    assert set(suspects) == {Entry(Quantity.KP, 1), Entry(Quantity.COMMAND_OFFSET, 2)}
    assert fit.values.kp[1] == pytest.approx(KP, rel=0.005)
    assert fit.values.command_offset[2] == pytest.approx(0.02, abs=2e-3)


@pytest.mark.parametrize(
    ("given", "kind"),
    [(values(kp=KP / 1.5), Quantity.KP), (replace(values(), mass=np.array([1.0, 1.0, 0.6])), Quantity.MASS)],
    ids=["the unit of all kp", "the mass of one body"],
)
def test_all_gains_are_told_from_the_mass_of_a_body(given: ServoValues, kind: Quantity) -> None:
    heavy = plant(servo_mjcf(FILE_VALUES).replace('mass="0.1', 'mass="0.5'))
    log = recording(duration=5.0)
    motion = smooth_servo_log(replace(log, q=np.round(heavy.rollout(values(), log)[0] / COUNT) * COUNT))
    _, fit, suspects = choose_fit(heavy, [motion], given, settings_of(delay=TRUE_DELAY, commands="held"))
    assert {entry.quantity for entry in suspects} == {kind}
    assert fit.values.kp[1:] == pytest.approx(KP, rel=0.02)
    assert fit.values.mass == pytest.approx(1.0, rel=0.02)


def test_commands_are_held_or_interpolated_as_the_log_says() -> None:
    log = recording(duration=2.0)
    (q,) = plant().rollout(values(), replace(log, held=False))
    motion = smooth_servo_log(replace(log, q=np.round(q / COUNT) * COUNT))
    motions, fit, _ = choose_fit(plant(), [motion], values(delay=0.0), settings_of())
    assert not motions[0].log.held
    assert abs(fit.values.delay - TRUE_DELAY) < 3e-4
    # a delay that is given is not moved, whatever the commands are
    motions, fit, _ = choose_fit(plant(), [motion], values(), settings_of(delay=TRUE_DELAY))
    assert not motions[0].log.held
    assert fit.values.delay == TRUE_DELAY


FINE_STEP, SIZE = 1e-3, 0.02  # s, rad


def slack_recording(seed: int, k: int, output: bool, duration: float = 3.0, stiffness: float = 0.0) -> ServoLog:
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
    _, *logs = servo_files(tmp_path, 3.0)
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
