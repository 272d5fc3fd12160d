"""Generalised least squares reach their bound with coloured noise, and say where the residual is no noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.estimators import GeneralisedLeastSquares, LeastSquares, PhysicallyConsistent, Problem
from dynident.estimators.notes import NotConverged, StillColoured, WhiteningCostly
from dynident.project.parts import build
from dynident.regression import ParallelFilter, Regression, Selection
from dynident.runtime import Use
from dynident.runtime.families import ESTIMATORS
from dynident.testing.estimator import make_problem, multisine_motion
from tests.estimators.coloured import ARM, COLOURED, bound, noisy, repeated

RUNS = 100
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
    found = GeneralisedLeastSquares()(noisy(COLOURED, 0, 10_000))
    noise = found.residual.whitening
    assert noise is not None
    assert noise.orders == COLOURED.orders
    np.testing.assert_allclose(noise.covariance, COLOURED.covariance, rtol=0.06)
    assert found.notes == ()
    np.testing.assert_allclose(found.residual.sigma, [0.0204, 0.0281], rtol=0.2)  # N m, not whitened


def test_a_filter_with_decimation_and_slow_samples() -> None:
    (motion,) = noisy(COLOURED, 1, 6000).motions
    for low, slow in ((ParallelFilter(decimate=4), None), (ParallelFilter(decimate=4), (0.2, 0.2)), (None, (0.2, 0.2))):
        given = Problem(ARM, (motion,), Regression(ARM, (motion,), Selection(low, slow)))
        found = GeneralisedLeastSquares()(given)
        assert (np.abs(found.value - ARM.values) < 4.5 * found.std).all()


def test_logs_are_not_joined() -> None:
    together, order = noisy(COLOURED, 2, 800, count=3), (2, 0, 1)
    turned = make_problem(ARM, *(together.motions[k] for k in order))
    one, other = GeneralisedLeastSquares()(together), GeneralisedLeastSquares()(turned)
    np.testing.assert_allclose(other.value, one.value, rtol=1e-7)


def test_an_error_of_the_model_is_said_and_does_little_harm() -> None:
    exact, rng = multisine_motion(ARM, noise=1e-3), np.random.default_rng(0)
    rough = exact.ddq + 0.5 * rng.standard_normal(exact.ddq.shape)
    lacking = replace(exact, ddq=rough, tau=exact.tau + 0.3 * np.sin(3.0 * exact.q))
    found = GeneralisedLeastSquares()(make_problem(ARM, lacking))
    plain = LeastSquares(weights="per_joint")(make_problem(ARM, lacking))
    assert [type(note) for note in found.notes] == [StillColoured, WhiteningCostly]
    assert [note.forbidden for note in found.notes] == [None, Use.SIMULATION]
    assert (found.residual.sigma < 4 * plain.residual.sigma).all()


def test_an_iteration_that_ends_early_says_so() -> None:
    found = GeneralisedLeastSquares(iterations=1)(noisy(COLOURED, 0))
    assert [type(note) for note in found.notes] == [NotConverged]
    assert not found.converged


def test_short_logs_have_no_order() -> None:
    for samples in (4, 5, 8, 20):
        short = make_problem(ARM, replace(multisine_motion(ARM, noise=0.01), mask=np.arange(2000) < samples))
        found = GeneralisedLeastSquares()(short)
        assert np.isfinite(found.value).all()
        assert (found.std > 0).all()


def test_constraints_take_the_whitened_rows() -> None:
    made = build(
        ESTIMATORS, {"kind": "consistent", "fit": {"kind": "generalised_least_squares", "max_order": 5}}, "estimator"
    )
    assert made == PhysicallyConsistent(fit=GeneralisedLeastSquares(max_order=5))
    given = noisy(COLOURED, 3)
    found, free = made(given), GeneralisedLeastSquares(max_order=5)(given)
    np.testing.assert_allclose(found.value, free.value, atol=1e-3 * free.std.min())  # it is consistent as it is
    np.testing.assert_allclose(found.std, free.std, rtol=1e-3)
    assert found.residual.whitening is not None
    assert found.needs_samples
