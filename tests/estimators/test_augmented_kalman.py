"""Kalman filtering of parameters: its steps, its errors beside maximum likelihood, and where it fails."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.article.article import arm_to_identify
from dynident.estimators import AugmentedKalman, Problem
from dynident.estimators.augmented_kalman import PRIOR_STD, _combine_pieces
from dynident.estimators.augmented_kalman_steps import correct_state, lower_root, series_of
from dynident.estimators.maximum_likelihood import MaximumLikelihood
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


def test_as_maximum_likelihood():
    problem = recorded(0)
    result, best = AugmentedKalman()(problem), MaximumLikelihood()(problem)
    assert (np.abs(result.value - best.value) < 3 * result.std).all()
    assert (result.std > 0.7 * best.std).all()
    assert result.information is not None


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


def test_terms_that_remember_are_refused():
    model = ARM.with_terms(Dahl(ARM.joints, length=0.1))
    motion = model.remembering(multisine_motion(ARM, samples=100))
    with pytest.raises(ConfigError, match="remember"):
        AugmentedKalman()(make_problem(model, motion))


def test_too_short():
    short = multisine_motion(ARM, samples=2000).select_between(stop=0.03)
    with pytest.raises(InputError, match="at least 12"):
        series_of(make_problem(ARM, short), 4000, np.ones(2), (np.zeros((2000, 2)),), (short.tau,))


def test_linear_case_is_least_squares():
    """A constant parameter drives a position; the filter's end is the weighted fit of all that is known together."""
    rng = np.random.default_rng(0)
    steps, sigma, noise, start = 30, np.array([0.1]), 0.05, np.diag([1.0, 2.0, 3.0])
    F = np.array([[1.0, 0.1, 0.005], [0.0, 1.0, 0.1], [0.0, 0.0, 1.0]])
    G = np.array([[0.005], [0.1], [0.0]])
    y = rng.standard_normal(steps)
    x, S = np.zeros((1, 3)), start[None]
    for case in y:
        x, S, _ = correct_state(
            (F @ x.T).T, lower_root(np.concatenate([F @ S, (noise * G)[None]], axis=2)), case[None, None], sigma
        )
    # the unknowns: the first state and the noise of each step
    rows, right = [np.linalg.inv(start) @ np.eye(3, 3 + steps)], [np.zeros(3)]
    state = np.eye(3, 3 + steps)
    for k, case in enumerate(y):
        state = F @ state + G @ np.eye(3 + steps)[[3 + k]]
        rows += [np.eye(3 + steps)[[3 + k]] / noise, state[:1] / sigma]
        right += [np.zeros(1), case / sigma]
    X = np.concatenate(rows)
    result = np.linalg.lstsq(X, np.concatenate(right), rcond=None)[0]
    np.testing.assert_allclose(x[0], state @ result, rtol=1e-9)
    np.testing.assert_allclose(S[0] @ S[0].T, state @ np.linalg.inv(X.T @ X) @ state.T, rtol=1e-9)
