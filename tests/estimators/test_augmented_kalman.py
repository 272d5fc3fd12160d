"""Kalman filtering of parameters: intervals that hold, and where it fails."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.article.article import arm_to_identify
from dynident.estimators import AugmentedKalman, Problem
from dynident.estimators.augmented_kalman import PRIOR_STD, _combine_pieces
from dynident.estimators.augmented_kalman_steps import series_of
from dynident.models.friction import Dahl
from dynident.models.lagrangian import pendulum, two_link_arm
from dynident.models.simulation import record, simulate
from dynident.motion.log import Motion
from dynident.motion.smoothers import Spline
from dynident.regression import Regression
from dynident.runtime import ConfigError, InputError
from dynident.testing.estimator import make_problem, multisine_motion

ARM = two_link_arm()


@cache
def swinging(samples: int) -> Motion:
    arm = pendulum()
    return simulate(arm, arm.values, lambda s: [np.sin(5 * s)], np.arange(samples) * 0.01)


def recorded(seed: int, samples: int = 801) -> Problem:
    arm = pendulum()
    log = record(swinging(samples), sigma_q=1e-4, sigma_tau=0.01, rng=np.random.default_rng(seed)).log
    smooth = Spline(sigma=1e-4)(log)
    return Problem(arm, (smooth,), Regression(arm, (smooth,)), (log,))


def test_intervals_hold():
    """95 % of them, with noise in positions and torque."""
    inside = []
    for seed in range(8):
        problem = recorded(seed, 401)
        result = AugmentedKalman(passes=1)(problem)
        inside.append(np.abs(result.value - problem.model.values) < 1.96 * result.std)
    assert np.mean(inside) > 0.75  # of 16: 3.7 standard deviations below 0.95


def test_divergence_is_said():
    motion = multisine_motion(ARM, 0.01, samples=400)
    wrong = replace(motion, tau=0 * motion.tau)  # so that least squares finds no mass
    with pytest.raises(InputError, match="Kalman filter diverged"):
        AugmentedKalman()(make_problem(arm_to_identify(), wrong))
    with pytest.raises(InputError, match="Kalman filter diverged"):  # less is known than before the first step
        _combine_pieces(np.zeros((1, 2)), np.diag([2.0 * PRIOR_STD, 0.1])[None], 1.0)


def test_terms_that_remember_and_short_motions_are_refused():
    model = ARM.with_terms(Dahl(ARM.joints, length=0.1))
    motion = model.remembering(multisine_motion(ARM, samples=100))
    with pytest.raises(ConfigError, match="remember"):
        AugmentedKalman()(make_problem(model, motion))
    short = multisine_motion(ARM, samples=2000).select_between(stop=0.03)
    with pytest.raises(InputError, match="at least 12"):
        series_of(make_problem(ARM, short), 4000, np.ones(2), (np.zeros((2000, 2)),), (short.tau,))
