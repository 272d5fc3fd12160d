"""Least squares of recordings that are smoothed anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.article import SCENARIOS
from dynident.apps.article.article import SAMPLING_PERIOD, SPLINE, arm_to_identify
from dynident.estimators import AugmentedKalman, Estimator, InstrumentalVariables, LeastSquares, Problem
from dynident.estimators.simulated_recordings import fit_resmoothed
from dynident.models.lagrangian import pendulum
from dynident.models.simulation import Function, Recording, record, simulate
from dynident.motion.smoothers import Difference, KalmanSmoother, Smoother, Spline
from dynident.regression import Regression
from dynident.runtime import InputError

ARM = pendulum()
SIGMA = 3e-3
START = 0.25  # s: the transient before is not used


@pytest.fixture(scope="module")
def swing() -> Recording:
    t = np.arange(1501) * 0.004
    motion = simulate(ARM, ARM.values, lambda s: np.array([0.6 * np.sin(2 * s)]), t)
    return record(motion, SIGMA, 0.01, np.random.default_rng(0))


def posed(swing: Recording, smoother: Smoother) -> Problem:
    motion = smoother(swing.log)
    return Problem(ARM, (motion,), Regression(ARM, (motion,)), (swing.log,))


def test_it_is_least_squares_of_the_other_motion(swing: Recording) -> None:
    expected = LeastSquares(weights="per_joint")(posed(swing, Spline(sigma=SIGMA))).value
    found = fit_resmoothed(posed(swing, Difference("central")), Spline(sigma=SIGMA))
    np.testing.assert_allclose(found, expected, rtol=0.02)  # the samples at the ends of differences do not count


def test_without_a_log_the_motion_stays(swing: Recording) -> None:
    problem = replace(posed(swing, Spline(sigma=SIGMA)), logs=())
    np.testing.assert_allclose(
        fit_resmoothed(problem, KalmanSmoother()), LeastSquares(weights="per_joint")(problem).value
    )


@pytest.fixture(scope="module")
def noisy() -> Problem:
    """The article's arm at its highest noise: of its spline, the mass matrix is not positive definite."""
    scenario, model = SCENARIOS["tabulated"], arm_to_identify()
    log = scenario.record(1e-4, np.random.default_rng(0)).log
    first, second = scenario.amplitudes

    def law(t: float, q: np.ndarray, dq: np.ndarray, reference: np.ndarray) -> np.ndarray:
        return np.array([first * np.sin(t + SAMPLING_PERIOD / 2), second * np.cos(t + SAMPLING_PERIOD / 2)])

    still, ones = np.zeros_like(log.q), np.ones(2)
    log = replace(log, controller=Function(log.joints, log.t, still, law, ones, 1e9 * ones, still))
    motion = replace(SPLINE, sigma=1e-2)(log).select_between(start=START)
    return Problem(model, (motion,), Regression(model, (motion,)), (log,))


@pytest.mark.parametrize("estimator", [InstrumentalVariables(instruments="simulated"), AugmentedKalman()])
def test_what_simulates_starts_there_where_the_first_model_has_no_mass(noisy: Problem, estimator: Estimator) -> None:
    q = noisy.motions[0].q[::50]
    model, plain = noisy.model, LeastSquares(weights="per_joint")(noisy).value
    assert not model.check_mass_matrix(q, plain).positive
    assert model.check_mass_matrix(q, fit_resmoothed(noisy, KalmanSmoother())).positive
    found = estimator(noisy)
    assert np.isfinite(found.value).all()
    assert (found.std > 0).all()


def test_where_that_fails_too_the_first_error_stands(noisy: Problem) -> None:
    (motion,) = noisy.motions
    wrong = replace(motion, tau=-motion.tau)
    without = replace(noisy, logs=(), motions=(wrong,), regression=Regression(noisy.model, (wrong,)))
    with pytest.raises(InputError, match="the Kalman filter diverged"):
        AugmentedKalman()(without)
