"""Weighted and generalised least squares: their bound, and a residual that is no noise."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import GeneralisedLeastSquares, LeastSquares, LinearEstimator, Problem, WeightedLeastSquares
from dynident.estimators.notes import StillColoured, WhiteningCostly
from dynident.regression import ParallelFilter, Regression, Selection
from dynident.runtime import ConfigError, Use
from dynident.testing.estimator import make_problem, multisine_motion
from tests.estimators.coloured import ARM, COLOURED, CORRELATED, bound, noisy, repeated

RUNS = 60
SURE = 1 + 4 / np.sqrt(2 * RUNS * 7)  # of a root mean square over all parameters, were they independent


def test_errors_are_those_of_the_bound() -> None:
    least = bound(COLOURED)
    error, std = repeated(COLOURED, GeneralisedLeastSquares(), RUNS)
    plain, small = repeated(COLOURED, LeastSquares(weights="per_joint"), RUNS)
    assert np.sqrt(np.mean((error / least) ** 2)) < SURE
    assert np.sqrt(np.mean((plain / least) ** 2)) > 1.2
    assert 0.90 < (np.abs(error) < 1.96 * std).mean() < 0.98
    assert (np.abs(plain) < 1.96 * small).mean() < 0.6


def test_the_noise_is_found_and_nothing_is_to_be_noted() -> None:
    result = GeneralisedLeastSquares()(noisy(COLOURED, 0, 10_000))
    noise = result.residual.whitening
    assert noise.orders == COLOURED.orders
    np.testing.assert_allclose(noise.covariance, COLOURED.covariance, rtol=0.06)
    assert result.notes == ()
    np.testing.assert_allclose(result.residual.sigma, [0.0204, 0.0281], rtol=0.2)  # N m, not whitened


def test_an_error_of_the_model_is_said_and_does_little_harm() -> None:
    exact, rng = multisine_motion(ARM, noise=1e-3), np.random.default_rng(0)
    rough = exact.ddq + 0.5 * rng.standard_normal(exact.ddq.shape)
    lacking = replace(exact, ddq=rough, tau=exact.tau + 0.3 * np.sin(3.0 * exact.q))
    result = GeneralisedLeastSquares()(make_problem(ARM, lacking))
    plain = LeastSquares(weights="per_joint")(make_problem(ARM, lacking))
    assert [type(note) for note in result.notes] == [StillColoured, WhiteningCostly]
    assert [note.forbidden for note in result.notes] == [None, Use.SIMULATION]
    assert (result.residual.sigma < 4 * plain.residual.sigma).all()


def test_bound_of_correlated_noise() -> None:
    least = bound(CORRELATED)
    error, std = repeated(CORRELATED, WeightedLeastSquares(), RUNS)
    plain, _ = repeated(CORRELATED, LeastSquares(weights="per_joint"), RUNS)
    assert np.sqrt(np.mean((error / least) ** 2)) < SURE
    assert np.mean((plain / least) ** 2) > 1.05 * np.mean((error / least) ** 2)
    np.testing.assert_allclose(std.mean(axis=0), least, rtol=0.03)
    assert 0.92 < (np.abs(error) < 1.96 * std).mean() < 0.98


def test_it_needs_all_samples() -> None:
    given = noisy(CORRELATED, 0)
    assert WeightedLeastSquares()(given).needs_samples
    alone = Regression(ARM, ()).with_factors(given.regression.triangular_factors)
    with pytest.raises(ConfigError, match="needs all samples"):
        WeightedLeastSquares()(Problem(ARM, (), alone))


WHITENING = pytest.mark.parametrize("estimator", [GeneralisedLeastSquares(), WeightedLeastSquares()], ids=repr)


@WHITENING
def test_a_filter_with_decimation_and_slow_samples(estimator: LinearEstimator) -> None:
    (motion,) = noisy(COLOURED if estimator == GeneralisedLeastSquares() else CORRELATED, 1, 6000).motions
    for low, slow in ((ParallelFilter(decimate=4), None), (ParallelFilter(decimate=4), (0.2, 0.2)), (None, (0.2, 0.2))):
        estimate = estimator(Problem(ARM, (motion,), Regression(ARM, (motion,), Selection(low, slow))))
        assert (np.abs(estimate.value - ARM.values) < 4.5 * estimate.std).all()


@WHITENING
@pytest.mark.parametrize("samples", [4, 5, 8, 20])
def test_few_samples(estimator: LinearEstimator, samples: int) -> None:
    short = make_problem(ARM, replace(multisine_motion(ARM, noise=0.01), mask=np.arange(2000) < samples))
    estimate = estimator(short)
    assert np.isfinite(estimate.value).all()
    assert (estimate.std > 0).all()
