"""The noise in a residual, its orders and covariance; whether it explains how far two fits are apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import GeneralisedLeastSquares, LeastSquares, Problem
from dynident.estimators.noise import (
    MAX_CORRELATION_LAG,
    HausmanTest,
    Residuals,
    ResidualSeries,
    autoregression,
    shrink_correlation,
)
from dynident.estimators.notes import WhiteningCostly
from dynident.regression import ParallelFilter, Regression, Selection, Whitening, preceding_counts, rank_of
from dynident.runtime import progress_to
from dynident.testing.estimator import multisine_motion
from tests.estimators.coloured import ARM, COLOURED, S, drawn, noisy


def series(x: np.ndarray, used: np.ndarray | None = None) -> ResidualSeries:
    """A series of one joint."""
    kept = np.ones(len(x), dtype=bool) if used is None else used
    return ResidualSeries(np.where(kept, x, 0.0)[None], kept[None], preceding_counts(kept)[None])


def test_orders_and_coefficients_are_found() -> None:
    e = drawn(COLOURED, 20_000, np.random.default_rng(0))
    for j, expected in enumerate(COLOURED.coefficients):
        model = autoregression(series(e[:, j]), 0, 20)
        assert len(model) == len(expected)
        np.testing.assert_allclose(model, expected, atol=4.5 / np.sqrt(20_000))


def test_gaps_do_not_count() -> None:
    rng = np.random.default_rng(1)
    e, used = drawn(COLOURED, 20_000, rng)[:, 0], rng.uniform(size=20_000) > 0.05
    model = autoregression(series(np.where(used, e, 1e6), used), 0, 20)
    np.testing.assert_allclose(model, COLOURED.coefficients[0], atol=0.05)


@pytest.mark.parametrize("x", [np.ones(200), np.sin(np.arange(200)), np.arange(200.0), np.zeros(200), np.ones(3)])
def test_it_is_stable_whatever_the_residual(x: np.ndarray) -> None:
    a = autoregression(series(x), 0, 20)
    assert len(a) <= len(x) // 10
    assert Whitening((a,), np.eye(1)).orders == (len(a),)  # which refuses others


def test_white_noise_has_no_order_and_a_given_one_is_kept() -> None:
    x = series(np.random.default_rng(2).standard_normal(2000))
    assert len(autoregression(x, 0, 20)) == 0
    assert len(autoregression(x, 0, 20, 3)) == 3
    assert not x.correlations(0).any()
    assert len(x.correlations(0)) == MAX_CORRELATION_LAG


def test_a_correlation_that_is_chance_is_none() -> None:
    few = np.array([[1.0, 0.3], [0.3, 1.0]])
    np.testing.assert_array_equal(shrink_correlation(few, np.full((2, 2), 10.0)), np.eye(2))
    np.testing.assert_allclose(shrink_correlation(few, np.full((2, 2), 1e5)), few, atol=1e-3)
    by_chance = 0.91**2 / 100 / 0.09  # the variance of a correlation, by its square
    assert shrink_correlation(few, np.full((2, 2), 100.0))[0, 1] == pytest.approx(0.3 * (1 - by_chance))
    np.testing.assert_array_equal(shrink_correlation(np.eye(1), np.ones((1, 1))), np.eye(1))
    np.testing.assert_array_equal(shrink_correlation(np.eye(2), np.zeros((2, 2))), np.eye(2))


def test_noise_that_two_joints_share_can_be_inverted() -> None:
    result = shrink_correlation(np.ones((3, 3)), np.full((3, 3), 1000.0))
    assert np.linalg.cond(result) < 1e4


def test_the_noise_of_a_problem_is_that_of_its_joints() -> None:
    problem = noisy(COLOURED, 0, 20_000)
    result = Residuals.of(problem.regression, ARM.values, np.zeros(2)).noise(20, 7)  # type: ignore[arg-type]
    assert result.orders == (2, 1)
    np.testing.assert_allclose(result.covariance, S, rtol=0.05)


def test_a_residual_of_rounding_is_no_noise() -> None:
    problem = noisy(COLOURED, 0)
    result = Residuals.of(problem.regression, ARM.values, np.array([1.0, 0.0])).noise(20, 7)  # type: ignore[arg-type]
    assert result.orders[0] == 0
    assert result.covariance[0, 0] == 1.0


def test_joints_that_are_never_used_together_are_not_correlated() -> None:
    problem = noisy(COLOURED, 0)
    (motion,) = problem.motions
    keep = np.zeros(motion.q.shape, dtype=bool)
    keep[:700, 0] = keep[700:, 1] = True
    regression = replace(problem.regression, motions=(replace(motion, keep=keep),))
    result = Residuals.of(regression, ARM.values, np.zeros(2)).noise(20, 7)  # type: ignore[arg-type]
    assert not result.mixes


SLOW = Whitening((np.array([0.999]), np.array([0.99])), S)
RUNS, SAMPLES = 40, 400


def test_slow_noise_is_seldom_taken_for_what_the_model_lacks() -> None:
    """Least squares takes slow noise for motion: the other fit leaves more of the torque, and is right."""
    more = noted = denied = 0
    for seed in range(RUNS):
        given = noisy(SLOW, seed, SAMPLES)
        result, plain = GeneralisedLeastSquares()(given), LeastSquares(weights="per_joint")(given)
        more += bool((result.residual.sigma / plain.residual.sigma).max() > 1.1)
        costly = [note for note in result.notes if isinstance(note, WhiteningCostly)]
        noted += len(costly)
        denied += sum(note.forbidden is not None for note in costly)
    assert noted == more >= 5
    assert denied <= 3  # of a rate of 2 %, more in 1 % of all seeds


def _apart(low: ParallelFilter | None) -> tuple[HausmanTest, Whitening]:
    motion = replace(multisine_motion(ARM, samples=1500), mask=np.arange(1500) % 700 > 20)
    plain = Regression(ARM, (motion,), Selection(low))
    return HausmanTest(plain, LeastSquares().reduced(Problem(ARM, (motion,), plain))), COLOURED


def test_the_distance_is_that_of_the_torques() -> None:
    apart, _ = _apart(None)
    by = np.random.default_rng(0).standard_normal((len(ARM.parameters), 2))
    start = apart.fit.solution.value
    rest = [apart.plain.triangular_factors.residual(start + x).sum() for x in (0.0 * by[:, 0], *by.T)]
    np.testing.assert_allclose(apart.distance(by), np.array(rest[1:]) - rest[0], rtol=1e-6)


def test_the_noise_that_is_drawn_is_that_which_was_found() -> None:
    """Of rows that are decimated, and in stretches: those that follow each other have the noise of neighbours."""
    for low in (None, ParallelFilter(decimate=2)):
        apart, noise = _apart(low)
        (drawn,) = apart._draw_noise(noise, 200, np.random.default_rng(0))
        rows = np.arange(21, 700, 1 if low is None else 2)
        first, second = drawn[rows, 1][1:], drawn[rows, 1][:-1]
        np.testing.assert_allclose(np.mean(first * second) / np.mean(second**2), 0.9, atol=0.01)
        u = first - 0.9 * second
        np.testing.assert_allclose(np.mean(u**2), S[1, 1], rtol=0.03)
        assert not drawn[~apart.plain.motions[0].mask].any()


def test_what_chance_explains() -> None:
    for low in (None, ParallelFilter(decimate=2)):
        apart, noise = _apart(low)
        rank = rank_of(replace(apart.plain, whitening=noise).triangular_factors.stack())
        usual = np.sqrt(np.diag(rank.inverse))
        steps: list[str] = []
        with progress_to(steps.append):
            assert apart.is_chance(0.5 * usual, noise, rank)
            assert not apart.is_chance(30.0 * usual, noise, rank)
        assert steps[0] == "simulating the noise (0 of 99)"
