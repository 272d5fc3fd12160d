"""The samples that a model is to explain: low-passed, thinned, and only those that the fit has, too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.misfit import CASE_SAMPLES, fit_case, measured_case
from dynident.motion.log import Motion
from dynident.regression import ParallelFilter
from tests.checks.moving_arm import T, arm, motion


def test_rows_near_a_reversal_do_not_count() -> None:
    moved = motion()
    kept = fit_case(arm(), [moved], samples=len(T)).keep
    for j in range(3):
        turns = T[np.flatnonzero(np.diff(np.signbit(moved.dq[:, j])))]
        away = np.abs(T[:, None] - turns).min(axis=1)
        assert not kept[away < 0.07, j].any()
        assert kept[away > 0.08, j].all()


def test_a_long_log_is_thinned_and_a_slow_one_is_not_filtered() -> None:
    moved = motion()
    many = Motion(
        np.arange(4 * len(T)) * 0.01, *(np.tile(x, (4, 1)) for x in (moved.q, moved.dq, moved.ddq, moved.tau)),
        moved.joints, np.ones(4 * len(T), bool),
    )  # fmt: skip
    assert CASE_SAMPLES <= len(fit_case(arm(), [many]).q) <= 2 * CASE_SAMPLES
    slow = replace(moved, t=10.0 * moved.t)
    np.testing.assert_array_equal(fit_case(arm(), [slow], samples=len(T)).tau, moved.tau)


def test_what_the_fit_leaves_out_does_not_count() -> None:
    moved, keep = motion(), np.ones((len(T), 3), dtype=bool)
    keep[300:320, 1] = False
    whole, less = (fit_case(arm(), [one], samples=len(T)) for one in (moved, replace(moved, keep=keep)))
    np.testing.assert_array_equal(less.keep, whole.keep & keep)
    fast = fit_case(arm(), [moved], min_speed=(0.1, 0.2, 0.3), samples=len(T)).keep
    assert not fast[np.abs(moved.dq) < 0.9 * np.array([0.1, 0.2, 0.3])].any()


@pytest.mark.parametrize("given", [ParallelFilter(decimate=8), ParallelFilter(cutoff=5.0)])
def test_the_filter_of_the_recipe_counts_however_it_is_given(given: ParallelFilter) -> None:
    """At 100 Hz a decimation by 8 cuts off at 5 Hz."""
    moved = motion()
    slow = ParallelFilter(cutoff=5.0).filter_motion(moved)
    np.testing.assert_allclose(fit_case(arm(), [moved], given, samples=len(T)).tau, slow.tau)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_logs_of_other_rates_have_one_noise(order: list[int]) -> None:
    """At twice the rate white noise has half of its energy below the same frequency."""
    rng, moved = np.random.default_rng(4), motion(noise=0.0)
    t = np.arange(2 * len(T)) * 0.5 * (T[1] - T[0])
    q, dq, ddq, tau = (np.column_stack([np.interp(t, T, x) for x in getattr(moved, name).T])
                       for name in ("q", "dq", "ddq", "tau"))  # fmt: skip
    dense = Motion(t, q, dq, ddq, tau, moved.joints, np.ones(len(t), bool))
    noisy = [replace(one, tau=one.tau + rng.standard_normal(one.tau.shape)) for one in (moved, dense)]
    single = [fit_case(arm(), [one], samples=len(T)).noise for one in noisy]
    np.testing.assert_allclose(single[1], 0.5 * single[0], rtol=0.3)
    both = fit_case(arm(), [noisy[k] for k in order], samples=len(T)).noise
    assert (single[1] < both).all()
    assert (both < single[0]).all()


def test_as_measured_all_samples_are_there_and_those_left_out_do_not_count() -> None:
    moved = motion()
    mask, keep = T < 5.0, np.ones((len(T), 3), dtype=bool)
    keep[300:320, 1] = False
    whole = measured_case(arm(), [replace(moved, mask=mask, keep=keep), moved], (0.1, 0.0, 0.0))
    np.testing.assert_array_equal(whole.tau, np.concatenate([moved.tau, moved.tau]))
    assert whole.lengths == (len(T), len(T))
    fast = np.abs(moved.dq[:, 0]) >= 0.1
    np.testing.assert_array_equal(
        whole.keep[: len(T)], mask[:, None] & keep & np.column_stack([fast, *2 * [fast | True]])
    )
    np.testing.assert_array_equal(whole.keep[len(T) :, 0], fast)
