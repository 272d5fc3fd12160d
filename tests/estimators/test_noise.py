"""The noise in a residual, its orders and covariance; whether it explains how far two fits are apart."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import GeneralisedLeastSquares, LeastSquares, Problem
from dynident.estimators.noise import HausmanTest, Residuals, ResidualSeries, autoregression
from dynident.estimators.notes import WhiteningCostly
from dynident.regression import ParallelFilter, Regression, Selection, Whitening, preceding_counts, rank_of
from dynident.runtime import progress_to
from dynident.testing.estimator import multisine_motion
from tests.estimators.coloured import ARM, COLOURED, S, noisy


def series(x: np.ndarray, used: np.ndarray | None = None) -> ResidualSeries:
    """A series of one joint."""
    kept = np.ones(len(x), dtype=bool) if used is None else used
    return ResidualSeries(np.where(kept, x, 0.0)[None], kept[None], preceding_counts(kept)[None])


@pytest.mark.parametrize("x", [np.ones(200), np.sin(np.arange(200)), np.arange(200.0), np.zeros(200), np.ones(3)])
def test_it_is_stable_whatever_the_residual(x: np.ndarray) -> None:
    a = autoregression(series(x), 0, 20)
    assert len(a) <= len(x) // 10
    assert Whitening((a,), np.eye(1)).orders == (len(a),)  # which refuses others


def test_the_noise_of_a_problem_is_that_of_its_joints() -> None:
    problem = noisy(COLOURED, 0, 20_000)
    result = Residuals.of(problem.regression, ARM.values, np.zeros(2)).noise(20, 7)  # type: ignore[arg-type]
    assert result.orders == (2, 1)
    np.testing.assert_allclose(result.covariance, S, rtol=0.05)


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
