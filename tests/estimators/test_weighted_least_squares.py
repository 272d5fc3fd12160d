"""Weighted least squares reach their bound where the noise of joints is correlated, and are simpler elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import LeastSquares, PhysicallyConsistent, Problem, WeightedLeastSquares
from dynident.models.lagrangian import slider
from dynident.regression import Regression, Selection
from dynident.runtime import ConfigError
from dynident.testing.estimator import make_problem, multisine_motion
from tests.estimators.arms import arm, problem
from tests.estimators.coloured import ARM, CORRELATED, bound, noisy, repeated

RUNS = 100
SURE = 1 + 4 / np.sqrt(2 * RUNS * 7)  # of a root mean square over all parameters, were they independent


def test_errors_are_those_of_the_bound() -> None:
    least = bound(CORRELATED)
    error, std = repeated(CORRELATED, WeightedLeastSquares(), RUNS)
    plain, _ = repeated(CORRELATED, LeastSquares(weights="per_joint"), RUNS)
    assert np.sqrt(np.mean((error / least) ** 2)) < SURE
    assert np.mean((plain / least) ** 2) > 1.05 * np.mean((error / least) ** 2)
    np.testing.assert_allclose(std.mean(axis=0), least, rtol=0.03)
    assert 0.92 < (np.abs(error) < 1.96 * std).mean() < 0.98


def test_with_independent_noise_it_is_least_squares_weighted_by_joint() -> None:
    posed_one = make_problem(ARM, multisine_motion(ARM, noise=0.01))
    found, plain = WeightedLeastSquares()(posed_one), LeastSquares(weights="per_joint", iterations=20)(posed_one)
    np.testing.assert_allclose(found.value, plain.value, atol=0.01 * plain.std.min())
    np.testing.assert_allclose(found.std, plain.std, rtol=1e-3)
    assert found.residual.whitening is not None
    assert not found.residual.whitening.mixes


def test_one_joint_is_plain_least_squares() -> None:
    one = slider(values=(5.0, 8.0, 3.0, 0.5))
    given = make_problem(one, multisine_motion(one, noise=0.1))
    found, plain = WeightedLeastSquares()(given), LeastSquares()(given)
    np.testing.assert_allclose(found.value, plain.value, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, plain.covariance, rtol=1e-9)


def test_an_arm_whose_parameters_are_not_all_determined() -> None:
    given = problem(arm(), samples=600)
    found, plain = WeightedLeastSquares()(given), LeastSquares(weights="per_joint")(given)
    assert found.determined.rank == plain.determined.rank < len(found.value)
    np.testing.assert_array_equal(np.isinf(found.std), np.isinf(plain.std))
    basis = plain.determined.directions
    assert basis is not None
    known = basis.determined_directions.T @ np.diag(basis.scale**2)
    change = known @ (found.value - plain.value)
    assert np.linalg.norm(change) < 0.1 * np.linalg.norm(known @ plain.value)
    assert found.unwhitened_rank is not None
    assert found.unwhitened_rank.rank == found.determined.rank
    consistent = PhysicallyConsistent(fit=WeightedLeastSquares(), costs=False)(given)
    assert min(consistent.consistency.eigenvalues.values()) > 0  # type: ignore[union-attr]
    assert consistent.residual.whitening is not None


def test_slow_samples_and_short_logs() -> None:
    (motion,) = noisy(CORRELATED, 0).motions
    regression = Regression(ARM, (motion,), selection=Selection(min_speed=(0.3, 0.2)))
    found = WeightedLeastSquares()(Problem(ARM, (motion,), regression))
    assert (np.abs(found.value - ARM.values) < 4.5 * found.std).all()
    for samples in (4, 5, 8, 20):
        short = make_problem(ARM, replace(multisine_motion(ARM, noise=0.01), mask=np.arange(2000) < samples))
        few = WeightedLeastSquares()(short)
        assert np.isfinite(few.value).all()
        assert (few.std > 0).all()


def test_it_needs_all_samples() -> None:
    given = noisy(CORRELATED, 0)
    assert WeightedLeastSquares()(given).needs_samples
    alone = Regression(ARM, ()).with_factors(given.regression.triangular_factors)
    with pytest.raises(ConfigError, match="needs all samples"):
        WeightedLeastSquares()(Problem(ARM, (), alone))
    assert WeightedLeastSquares().quick() == LeastSquares(weights="per_joint")
