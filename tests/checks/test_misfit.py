"""The samples that a model is to explain, and what a residual says of one more unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.misfit import CASE_SAMPLES, column_of_joint, fit_case, measured_case, misfit
from dynident.motion.log import Motion
from dynident.regression import ParallelFilter
from tests.checks.moving_arm import MOVED, T, arm, case, motion, truth

RIGHT = case()
LEFT_OUT = np.ones((len(T), 3), dtype=bool)
LEFT_OUT[300:320, 1] = False


def at_rate(moved: Motion, factor: int) -> Motion:
    """The motion at so many times its rate."""
    t = np.arange(factor * len(T)) * (T[1] - T[0]) / factor
    states = (
        np.column_stack([np.interp(t, T, x) for x in getattr(moved, name).T]) for name in ("q", "dq", "ddq", "tau")
    )
    return Motion(t, *states, moved.joints, np.ones(len(t), bool))


def test_rows_near_a_reversal_do_not_count() -> None:
    kept = fit_case(arm(), [MOVED], samples=len(T)).keep
    for j in range(3):
        turns = T[np.flatnonzero(np.diff(np.signbit(MOVED.dq[:, j])))]
        away = np.abs(T[:, None] - turns).min(axis=1)
        assert not kept[away < 0.07, j].any()
        assert kept[away > 0.08, j].all()


def test_a_long_log_is_thinned_and_a_slow_one_is_not_filtered() -> None:
    assert CASE_SAMPLES <= len(fit_case(arm(), [at_rate(MOVED, 4)]).q) <= 2 * CASE_SAMPLES
    slow = replace(MOVED, t=10.0 * MOVED.t)
    np.testing.assert_array_equal(fit_case(arm(), [slow], samples=len(T)).tau, MOVED.tau)


def test_a_column_acts_at_its_joint_alone() -> None:
    column = column_of_joint(RIGHT, 1, np.ones(len(RIGHT.q)))
    np.testing.assert_array_equal(column, np.tile([0.0, 1.0, 0.0], (len(RIGHT.q), 1)))


def test_what_the_fit_leaves_out_does_not_count() -> None:
    full, less = (fit_case(arm(), [x], samples=len(T)) for x in (MOVED, replace(MOVED, keep=LEFT_OUT)))
    np.testing.assert_array_equal(less.keep, full.keep & LEFT_OUT)
    fast = fit_case(arm(), [MOVED], min_speed=(0.1, 0.2, 0.3), samples=len(T)).keep
    assert not fast[np.abs(MOVED.dq) < 0.9 * np.array([0.1, 0.2, 0.3])].any()


@pytest.mark.parametrize("given", [ParallelFilter(decimate=8), ParallelFilter(cutoff=5.0)])
def test_the_filter_of_the_recipe_counts_however_it_is_given(given: ParallelFilter) -> None:
    """At 100 Hz a decimation by 8 cuts off at 5 Hz."""
    slow = ParallelFilter(cutoff=5.0).filter_motion(MOVED)
    np.testing.assert_allclose(fit_case(arm(), [MOVED], given, samples=len(T)).tau, slow.tau)


def test_logs_of_other_rates_have_one_noise_in_any_order() -> None:
    """At twice the rate white noise has half of its energy below the same frequency; at a lower one, which the octave
    above the cut-off exceeds, more of it.
    """
    rng, silent = np.random.default_rng(4), motion(noise=0.0)
    noisy = [replace(x, tau=x.tau + rng.standard_normal(x.tau.shape)) for x in (silent, at_rate(silent, 2))]
    single = [fit_case(arm(), [x], samples=len(T)).noise for x in noisy]
    np.testing.assert_allclose(single[1], 0.5 * single[0], rtol=0.3)
    slow = replace(noisy[0], t=1.25 * noisy[0].t)
    np.testing.assert_allclose(fit_case(arm(), [slow], samples=len(T)).noise, 1.25 * single[0], rtol=0.3)
    for logs in (noisy, noisy[::-1]):
        both = fit_case(arm(), logs, samples=len(T)).noise
        assert (single[1] < both).all()
        assert (both < single[0]).all()


def test_as_measured_all_samples_are_there_and_those_left_out_do_not_count() -> None:
    mask = T < 5.0
    full = measured_case(arm(), [replace(MOVED, mask=mask, keep=LEFT_OUT), MOVED], (0.1, 0.0, 0.0))
    np.testing.assert_array_equal(full.tau, np.concatenate([MOVED.tau, MOVED.tau]))
    assert full.lengths == (len(T), len(T))
    fast = np.abs(MOVED.dq) >= [0.1, 0.0, 0.0]
    np.testing.assert_array_equal(full.keep, np.concatenate([mask[:, None] & LEFT_OUT & fast, fast]))


def column(j: int = 0) -> np.ndarray:
    return RIGHT.q * (np.arange(3) == j)


def test_an_unknown_is_found_as_if_it_had_been_fitted_with_all_others() -> None:
    spring = replace(RIGHT, tau=RIGHT.tau + 0.3 * column())
    fit = misfit(spring)
    (test,) = fit.score_tests([column()])
    assert test is not None
    full = misfit(replace(spring, extra=(column(),)), fit.weight.max(axis=0))
    assert test.share == pytest.approx(1.0 - full.size / fit.size, rel=1e-9)
    assert test.value == pytest.approx(0.3, abs=5 * test.std)
    assert test.by_joint[0] == pytest.approx(test.by_joint.max())
    assert 0.9 * test.share < test.held_out < test.share
    assert test.has_constant_sign


def test_its_standard_error_is_the_scatter_over_noises() -> None:
    fit = misfit(RIGHT)
    noise = np.random.default_rng(0).standard_normal((16, *RIGHT.q.shape)) / fit.weight.max(axis=0)
    tests = [test for x in noise for test in misfit(replace(RIGHT, tau=fit.predicted + x)).score_tests([column()])]
    assert np.std([x.value for x in tests]) == pytest.approx(np.mean([x.std for x in tests]), rel=0.5)


def test_what_the_model_has_already_cannot_be_seen() -> None:
    columns = (x * (np.arange(3) == 2) for x in (RIGHT.dq, RIGHT.ddq, np.ones_like(RIGHT.q)))
    assert list(misfit(RIGHT).score_tests(columns)) == [None] * 3


def test_a_chance_effect_does_not_hold_in_all_parts() -> None:
    noise = np.random.default_rng(5).standard_normal((10, *RIGHT.q.shape))
    for test in misfit(RIGHT).score_tests(noise):
        assert test is not None
        assert max(test.share, test.held_out) < 0.01


def test_white_noise_is_known_and_lowers_what_must_be_explained() -> None:
    sigma = (MOVED.tau - arm().torque(MOVED.q, MOVED.dq, MOVED.ddq, truth(arm()))).std(axis=0)
    kept = 20.0 / 50.0 * 0.93  # of its energy below the cut-off
    np.testing.assert_allclose(RIGHT.noise, kept * sigma**2, rtol=0.25)
    assert misfit(RIGHT).min_share < 0.05
    wrong = replace(MOVED, tau=MOVED.tau + 2.0 * np.sin(3.0 * MOVED.q))
    assert misfit(case(wrong)).min_share == 0.1


def test_what_is_left_free_has_the_values_of_the_file() -> None:
    model, fit = arm(), misfit(RIGHT)
    np.testing.assert_allclose(RIGHT.torque(fit.theta), fit.predicted, atol=1e-6 * np.abs(fit.predicted).max())
    mass = [x.name for x in model.parameters].index("shoulder.mass")
    assert fit.theta[mass] == pytest.approx(4.0)  # a mass on a vertical axis is not seen at all
