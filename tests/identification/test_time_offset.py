"""The time offset between torque and motion: one that was put in is found again, and no other."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from dynident.identification import Gain, Recipe, align_motion, calibration, find_time_offset, identify
from dynident.identification.calibration import ChosenTerms, Preparation, with_plain_terms
from dynident.identification.dataset import Dataset
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Dahl, Offset, Ripple, Viscous
from dynident.models.lagrangian import slider, two_link_arm
from dynident.models.simulation import record
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline, TimeShifted
from tests.identification.motions import sines
from tests.robots import joint, link, urdf

UPPER_ARM = RigidBodies(
    urdf(
        link("base"),
        link("upper", 3.0, (0.2, 0, 0.02), tensor=np.diag([0.01, 0.05, 0.05])),
        joint("j", "revolute", "base", "upper", (0, 0, 0.3), axis=(0, 1, 0)),
    )
)


def sliding(delay: float, noise: float, n: int = 4000, seed: int = 0) -> Motion:
    """A slider whose positions are ``late``, without noise, under a torque with white noise."""
    t = np.arange(n) * 0.0025

    def states(at: np.ndarray) -> tuple[np.ndarray, ...]:
        return sines(at, 0.2, [[3.0], [8.0]], [[0.0], [1.0]])

    force = slider().torque(*states(t), (5.0, 8.0, 3.0, 0.5))
    force = force + noise * np.random.default_rng(seed).standard_normal(force.shape)
    return Motion(t, *states(t - delay), force, ("slider",), np.ones(n, dtype=bool))


def left(motion: Motion) -> float:
    """The error of least squares in %, by hand."""
    Y = slider().regressor(motion.q, motion.dq, motion.ddq)[:, 0]
    rest = motion.tau[:, 0] - Y @ np.linalg.lstsq(Y, motion.tau[:, 0], rcond=None)[0]
    return float(100 * np.linalg.norm(rest) / np.linalg.norm(motion.tau))


@pytest.mark.parametrize("delay", [-0.09, -0.031, -0.004, -0.0006, 0.0018, 0.025, 0.034])
def test_the_time_offset_is_the_one_put_in_and_its_errors_are_those_by_hand(delay: float) -> None:
    motion = sliding(delay, 0.2)
    time_offset = find_time_offset(slider(), [motion])
    assert time_offset.seconds == pytest.approx(delay, abs=1e-4)
    assert ("look for two clocks or a buffer" in str(time_offset)) == (abs(delay) > 0.032)
    assert time_offset.before == pytest.approx(left(motion), rel=0.02)
    assert time_offset.after == pytest.approx(left(sliding(0.0, 0.2)), rel=0.02)


def test_an_offset_that_removes_next_to_nothing_of_the_error_is_none() -> None:
    """Half a percent of the error decides, also where the offset is four of its standard errors, as with the second."""
    for noise in (60.0, 7.0):
        small = find_time_offset(slider(), [sliding(0.004, noise)])
        assert small.seconds == 0.0
        assert small.after == small.before == pytest.approx(left(sliding(0.004, noise)), rel=0.02)
    assert find_time_offset(slider(), [sliding(0.004, 1.0)]).seconds == pytest.approx(0.004, abs=3e-4)


def test_two_hundred_samples_are_enough_for_an_offset() -> None:
    """Without those at the ends, which no trial may reach beyond."""
    few, enough = (find_time_offset(slider(), [sliding(0.004, 0.01, n)]) for n in (199, 300))
    assert few.seconds == 0.0
    assert np.isnan([few.before, few.after]).all()
    assert enough.seconds == pytest.approx(0.004, abs=1e-4)


def test_what_is_masked_does_not_count_in_an_offset_or_its_error() -> None:
    motion = sliding(0.004, 0.2)
    used = np.abs(np.arange(len(motion)) - 2000) > 50
    wrong = replace(motion, mask=used, tau=np.where(used[:, None], motion.tau, 1e4))
    clean, result = (find_time_offset(slider(), [x]) for x in (replace(motion, mask=used), wrong))
    assert (result.seconds, result.std, result.after) == pytest.approx(
        (clean.seconds, clean.std, clean.after), rel=1e-6
    )
    assert 0 < result.std < 1e-3


@cache
def swing(n: int = 2001, h: float = 0.0025) -> tuple[Model, Motion]:
    """An arm and a smooth motion, with the torque that it needs."""
    arm, t = two_link_arm(), np.arange(n) * h
    rate, size = np.array([[3.0, 4.0], [9.0, 13.0]]), np.array([[1.0, 0.7], [0.3, 0.2]])
    states = sines(t, size, rate, rate)
    names = tuple(joint.name for joint in arm.joints)
    return arm, Motion(t, *states, arm.torque(*states, arm.values), names, np.ones(n, dtype=bool))


def test_identify_takes_the_time_offset_into_account_and_says_so() -> None:
    arm, motion = swing()
    noisy = record(motion, 1e-5, 1e-2, np.random.default_rng(1)).log
    moved = replace(noisy, q=noisy.q - motion.q + motion.shift(-0.005).q).window(0.1, 4.9)
    recipe = Recipe(smoother=(Spline(), Spline(factor=2.0)), time_offset="estimate")
    result = identify(arm, [moved], (), recipe)
    plain = identify(arm, [moved])
    assert result.calibration.time_offset.seconds == pytest.approx(0.005, abs=1e-4)
    assert all(isinstance(candidate, TimeShifted) for candidate in result.calibration.smoother.candidates)
    assert result.validations[0].errors.relative_error < 0.7 * plain.validations[0].errors.relative_error
    np.testing.assert_allclose(result.estimate.value, arm.values, rtol=0.1)


def test_the_standard_error_of_a_time_offset_is_its_scatter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over 24 runs offsets over their standard errors have a mean square of one, within five of its deviations."""
    monkeypatch.setattr("dynident.identification.time_offset.MIN_ERROR_REDUCTION", -1.0)
    monkeypatch.setattr("dynident.identification.time_offset.MIN_SIGNIFICANCE", 0.0)
    monkeypatch.setattr(Gain, "sure", True)
    arm, motion = swing(1001, 0.01)
    ratios = []
    for seed in range(24):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(motion.tau.shape)
        time_offset = find_time_offset(arm, [replace(motion, tau=motion.tau + noise)])
        ratios.append(time_offset.seconds / time_offset.std)
    assert abs(np.mean(np.square(ratios)) - 1) < 5 * np.sqrt(2 / 24)
    assert np.std(ratios) > 0.3


def imitated(share: float) -> Motion:
    """A slider with a torque that grows with the jerk, as if it were late by 30 ms, in a share of the time."""
    motion = sliding(0.0, 0.2)
    there = np.arange(len(motion))[:, None] < share * len(motion)
    arm = slider()
    exact = [arm.torque(x.q, x.dq, x.ddq, (5.0, 8.0, 3.0, 0.5)) for x in (motion, motion.shift(-0.03))]
    return replace(motion, tau=motion.tau + np.where(there, exact[1] - exact[0], 0.0))


def test_an_offset_that_a_missing_torque_imitates_for_a_while_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error of the training falls by far more than is asked for; that of left-out stretches does not."""
    monkeypatch.setattr("dynident.identification.time_offset.MIN_SIGNIFICANCE", 0.0)
    part, full = (find_time_offset(slider(), [imitated(share)]) for share in (0.1, 1.0))
    assert part.gain.share < part.gain.std
    assert (part.seconds, part.after) == (0.0, part.before)
    assert full.gain.sure
    assert full.seconds == pytest.approx(-0.03, abs=1e-3)  # the torque is that of before


def test_what_the_model_lacks_at_one_joint_does_not_move_the_offset_of_all() -> None:
    """A ripple of the first joint, ten times the noise: joints count by what the model leaves of their torque."""
    arm, motion = swing()
    noise = 0.02 * np.random.default_rng(0).standard_normal(motion.tau.shape)
    ripple = np.column_stack([0.2 * np.sin(8 * motion.q[:, 0]), np.zeros(len(motion))])
    delayed = replace(motion.shift(-0.003), tau=motion.tau + noise + ripple)
    time_offset = find_time_offset(arm, [delayed])
    assert time_offset.seconds == pytest.approx(0.003, abs=2e-4)
    assert time_offset.std < 5e-4


def test_what_the_motion_invents_of_an_offset_is_taken_off() -> None:
    """Of 4 ms where a repetition without offset shows 1.5 ms, 2.5 ms are left; where it shows all, none."""
    motion = sliding(0.004, 0.2)
    result, none = (
        find_time_offset(slider(), [motion], repeat=lambda _, delayed=delayed: [[sliding(delayed, 0.2)]])
        for delayed in (0.0015, 0.00399)
    )
    assert result.seconds == pytest.approx(0.0025, abs=1e-4)
    assert result.after == pytest.approx(left(sliding(0.004 - result.seconds, 0.2)), rel=0.01)
    assert result.before == pytest.approx(left(motion), rel=0.02)
    assert none.seconds == 0.0
    assert none.after == none.before == pytest.approx(left(motion), rel=0.02)


@pytest.mark.parametrize("shown", [(-0.003, 0.003), (0.001, 0.045), (0.001, -0.045)])
def test_none_is_left_where_what_the_motion_invents_scatters_or_is_beyond_the_range(shown: tuple[float, float]) -> None:
    """Repetitions that show 3 ms of either sign have the mean zero +- 2.1 ms: 4 ms is no offset beside."""
    motion, sets = sliding(0.004, 0.2), [[sliding(delay, 0.2)] for delay in shown]
    time_offset = find_time_offset(slider(), [motion], repeat=lambda _: sets)
    assert time_offset.seconds == 0.0
    assert time_offset.after == time_offset.before == pytest.approx(left(motion), rel=0.02)
    if np.ptp(shown) < 0.01:
        assert time_offset.std == pytest.approx(0.003 / np.sqrt(2), rel=0.02)


@pytest.mark.parametrize(("noise", "seconds"), [(1.0, 0.06), (25.0, 0.0)])
def test_an_unusual_offset_must_explain_much(noise: float, seconds: float) -> None:
    """The friction that a model lacks looks like one that explains little."""
    time_offset = find_time_offset(slider(), [sliding(0.06, noise)])
    assert time_offset.seconds == pytest.approx(seconds, abs=2e-3)


def test_a_smoother_that_shifts_keeps_its_shift_unless_another_predicts_better() -> None:
    arm, motion = swing()
    noisy = record(motion, 1e-5, 1e-2, np.random.default_rng(3)).log
    log = replace(noisy, q=noisy.q - motion.q + motion.shift(-0.0033).q).window(0.1, 4.9)
    for start in (0.0033, 0.001):
        result = align_motion(arm, [log], (TimeShifted(Spline(), start),), "estimate")
        assert isinstance(result.smoother, TimeShifted)
        assert result.smoother.smoother == Spline()
        assert result.smoother.time_offset == result.time_offset.seconds == pytest.approx(0.0033, abs=1e-4)


def presliding(seed: int, delay: float = 0.004, length: float = 0.05, ripple: float = 0.0) -> Log:
    """An arm with friction that builds up over a ``length`` (rad), and with torques that are late by a delay (s)."""
    t, rng = np.arange(0, 12, 0.01), np.random.default_rng(seed)
    rates, phases, sizes = (rng.uniform(*limits, (4, 1)) for limits in ((0.8, 5.0), (0, 6), (0.15, 0.4)))
    angle = rates * t[:, None, None] + phases
    q, dq, ddq = (np.sum(sizes * rates**k * np.sin(angle + k * np.pi / 2), axis=1) for k in range(3))
    on = UPPER_ARM.joints
    terms = RotorInertia(on), Viscous(on), Dahl(on, length=length), Offset(on), Ripple(on, cycles=30)
    model, values = Model((UPPER_ARM, *terms)), {"Ia_j": 0.3, "Fv_j": 1.0, "Fd_j": 5.0, "offset_j": 0.4}
    theta = np.array([values.get(x.name, ripple) if x.value is None else x.value for x in model.parameters])
    motion = model.remembering(Motion(t, q, dq, ddq, np.zeros_like(q), ("j",), np.ones(len(t), bool)))
    tau = np.interp(t - delay, t, model.torque(**motion.states(), theta=theta)[:, 0])[:, None]
    tau = tau + 0.01 * tau.std() * rng.standard_normal(tau.shape)
    return Log(t, q + 1e-5 * rng.standard_normal(q.shape), tau, ("j",), f"log {seed}")


@pytest.mark.parametrize("delay", [0.0, 0.004])
def test_friction_that_builds_up_is_no_offset_where_the_model_lacks_it(delay: float) -> None:
    """With a sign of the velocity alone it looks like 32 ms and more."""
    model = with_plain_terms(Model((UPPER_ARM,)))
    result = align_motion(model, [presliding(5, delay, 0.005)], (Spline(sigma=1e-5),), "estimate")
    assert result.time_offset.seconds == pytest.approx(-delay, abs=5e-4)


@pytest.mark.parametrize("ripple", [0.0, 1.0])
def test_friction_that_builds_up_takes_its_share_of_the_offset_back(ripple: float) -> None:
    recipe = Recipe(Spline(sigma=1e-5), time_offset="estimate", terms="auto")
    logs = [presliding(seed, ripple=ripple) for seed in (4, 5)]  # of which a late ripple would keep what it looks like
    result = identify(Model((UPPER_ARM,)), {"a": logs[0]}, {"b": logs[1]}, recipe)
    assert result.calibration.time_offset.seconds == pytest.approx(-0.004, abs=5e-4)
    assert result.validations[1].errors.relative_error < 1.5


def test_reversals_below_a_minimum_speed_that_was_chosen_still_show_the_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    speeds, choose, prepare = [], calibration.add_chosen_terms, calibration.prepare

    def choose_speed(*parts: Any) -> ChosenTerms:
        terms = choose(*parts)
        return replace(terms, recipe=replace(terms.recipe, min_speed={"j": 0.1}))

    def record_speed(model: Model, data: Dataset, recipe: Recipe, *others: Any, **switches: bool) -> Preparation:
        speeds.append(recipe.min_speed)
        return prepare(model, data, recipe, *others, **switches)

    monkeypatch.setattr(calibration, "add_chosen_terms", choose_speed)
    monkeypatch.setattr(calibration, "prepare", record_speed)
    recipe = Recipe(Spline(sigma=1e-5), time_offset="estimate", terms="auto")
    result = identify(Model((UPPER_ARM,)), {"a": presliding(5)}, (), recipe)
    assert set(speeds) == {None}
    assert len(speeds) > 1
    assert result.recipe.min_speed == {"j": 0.1}
