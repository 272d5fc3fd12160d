"""The fit: known answers on a small arm, with their errors, a wrong kp, an unknown one, and a servo that diverges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.demo.servo_arm import COUNT, FILE_VALUES, KP, LIMIT, SERVO_JOINTS, TRUE_DELAY
from dynident.apps.servo.fit import fit_values, suspect_entries
from dynident.apps.servo.judge import ServoUse, position_noise, roll_out, verdict_of
from dynident.apps.servo.run import _fit_warnings, _spaced, choose_fit
from dynident.apps.servo.start import smooth_servo_log, start_values
from dynident.apps.servo.values import Entry, Quantity
from dynident.project.drive_settings import ServoSettings
from dynident.runtime import InputError, ModelError
from tests.apps.servo.arms import ENTRIES, plant, recording, values


@pytest.fixture(scope="module")
def motion():
    return smooth_servo_log(recording())


def test_commands_are_spaced_as_the_positions_of_their_rows() -> None:
    even = 0.01 * np.arange(20)
    jitter = 0.002 * np.sin(np.arange(20.0))
    spaced = _spaced(even + jitter, even[4:12])
    np.testing.assert_array_equal(spaced[4:12], even[4:12])
    np.testing.assert_array_equal(np.delete(spaced, range(4, 12)), np.delete(even + jitter, range(4, 12)))
    np.testing.assert_array_equal(_spaced(even + 3 * jitter, even[4:12]), np.sort(even + 3 * jitter))


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


def test_noise_of_counts_and_verdicts() -> None:
    rng = np.random.default_rng(1)
    smooth = np.sin(np.linspace(0, 30, 3000))[:, None]
    assert position_noise(np.round(smooth / 0.002) * 0.002)[0] == pytest.approx(0.002 / np.sqrt(12), rel=0.3)
    assert position_noise(smooth + 1e-3 * rng.standard_normal(smooth.shape))[0] == pytest.approx(1e-3, rel=0.1)
    assert verdict_of([]) is None


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


def test_friction_that_was_driven_to_zero_comes_back(motion) -> None:
    zero = replace(values(), frictionloss=np.array([1e-8, 0.06, 1e-8]))
    fit = fit_values(plant(), [motion], zero, ENTRIES)
    assert fit.converged
    assert fit.values.frictionloss == pytest.approx(values().frictionloss, rel=0.02)


def test_a_search_that_ends_away_from_the_minimum_has_not_converged(motion, monkeypatch) -> None:
    far = replace(values(), damping=2 * values().damping)
    monkeypatch.setattr("dynident.apps.servo.fit.MAX_REFUSALS", 0)  # each step is refused
    fit = fit_values(plant(), [motion], far, ENTRIES)
    assert fit.values.damping == pytest.approx(far.damping)
    assert not fit.converged
    assert "the search has not converged" in " ".join(_fit_warnings(fit, plant()))


def test_what_a_search_drives_to_zero_is_named() -> None:
    motion = smooth_servo_log(recording(duration=2.0))
    # a servo that already damps more than the arm does leaves less than none to the joint
    stiff = replace(values(), kd=np.array([0.0, 1.0, 0.0]))
    fit = fit_values(plant(), [motion], stiff, ENTRIES)
    assert Entry(Quantity.DAMPING, 1) in fit.vanished
    assert "damping of shoulder is driven to zero" in " ".join(_fit_warnings(fit, plant()))


def test_a_delay_grows_to_a_second_at_most() -> None:
    assert values().moved([Entry(Quantity.DELAY, 0)], [94.0]).delay == 1.0
