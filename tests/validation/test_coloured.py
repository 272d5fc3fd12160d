"""Standard errors for slow residuals: how often their intervals hold."""

import numpy as np
import pytest
from scipy.signal import lfilter

from dynident.estimators.least_squares import solve_least_squares
from dynident.models import Joint, Model
from dynident.models.friction import Offset, Viscous
from dynident.motion.log import Motion
from dynident.motion.splines import NORMAL_95
from dynident.regression import Regression
from dynident.runtime import ModelError
from dynident.validation import ColouredFit, correlated_std, plain_std, robust_covariance

JOINTS = (Joint("a"), Joint("b"))
MODEL = Model((Viscous(JOINTS), Offset(JOINTS)))
TRUTH = np.array([2.0, 3.0, 1.0, -1.0])
N = 2000


def regression(seed: int, rho: float, n: int = N, scale: float = 1.0) -> Regression:
    """MODEL on smooth velocities, with stationary residuals of first order and deviation 0.1 times ``scale``."""
    rng, t = np.random.default_rng(seed), np.arange(n) * 0.01
    dq = np.column_stack((np.sin(0.5 * t), np.cos(0.3 * t) + 0.2 * np.sin(t)))
    fresh = np.sqrt(1 - rho**2) * rng.standard_normal((n + 3000, 2))
    noise = lfilter([1.0], [1.0, -rho], fresh, axis=0)[3000:]
    tau = scale * (dq * TRUTH[:2] + TRUTH[2:] + 0.1 * noise)
    return Regression(MODEL, (Motion(t, 0 * dq, dq, 0 * dq, tau, ("a", "b"), np.ones(n, dtype=bool)),))


def fit(case: Regression) -> np.ndarray:
    return solve_least_squares(case.triangular_factors.stack()).value


@pytest.mark.parametrize("rho", [0.9, 0.995])
def test_intervals_hold_what_they_say(rho: float) -> None:
    """Of 140 x 4 intervals of 95 %, 91 to 99 % hold; four deviations of a binomial of 280 are 0.052.

    At 0.995 a log of 20 s has about five independent samples, and those of Newey and West hold below 80 %.
    """
    held, longrun = [], []
    for seed in range(140):
        case = regression(seed, rho)
        value = fit(case)
        error = np.abs(value - TRUTH)
        held.append(error < NORMAL_95 * correlated_std(case, value))
        if rho > 0.99:
            longrun.append(error < NORMAL_95 * np.sqrt(np.diag(robust_covariance(case, value))))
    assert 0.91 < np.mean(held) < 0.99
    assert np.mean(held, axis=0).min() > 0.85
    if rho > 0.99:
        assert np.mean(longrun) < 0.8


def test_white_residuals_have_the_plain_errors() -> None:
    case = regression(5, 0.0, 20_000)
    plain = plain_std(case, fit(case), np.ones(2), range(4))
    np.testing.assert_allclose(ColouredFit.of(case, fit(case)).std(), plain, rtol=0.05)
    white = solve_least_squares(case.triangular_factors.stack())
    np.testing.assert_allclose(plain, np.sqrt(np.diag(white.directions.inverse) * white.rss / 40_000), rtol=0.02)


def test_the_correlation_that_the_fit_takes_away_is_put_back() -> None:
    """Over 60 runs the standard errors are the scatter of 400 estimates, within five deviations of both."""
    told = np.array([ColouredFit.of(x, fit(x)).std() for x in (regression(seed, 0.97) for seed in range(60))])
    errors = np.array([fit(regression(seed, 0.97)) - TRUTH for seed in range(400)])
    np.testing.assert_allclose(np.sqrt((told**2).mean(axis=0)), errors.std(axis=0), rtol=5 * (0.04 + 0.02))


def test_dependent_columns_are_an_error() -> None:
    twice = Model((Viscous(JOINTS), Viscous(JOINTS, names=("again1", "again2"))))
    test_regression = Regression(twice, regression(0, 0.5).motions)
    with pytest.raises(ModelError, match="dependent"):
        correlated_std(test_regression, np.zeros(4))
