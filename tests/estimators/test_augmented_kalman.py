"""Kalman filtering of parameters: its steps, its errors beside maximum likelihood, and where it fails."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.article.article import arm_to_identify
from dynident.estimators import AugmentedKalman, LeastSquares, Problem
from dynident.estimators.augmented_kalman import PRIOR_STD, _combine_pieces
from dynident.estimators.augmented_kalman_steps import (
    Dynamics,
    FilterStep,
    correct_state,
    group_size,
    lower_root,
    series_of,
    smooth_model,
)
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.estimators.notes import StillMoving
from dynident.models import RotorInertia
from dynident.models.friction import Dahl
from dynident.models.lagrangian import pendulum, slider, two_link_arm
from dynident.models.simulation import record, simulate
from dynident.motion.log import Motion
from dynident.motion.smoothers import Spline
from dynident.regression import Regression
from dynident.runtime import ConfigError, InputError
from dynident.testing.estimator import make_problem, multisine_motion, truth

ARM = two_link_arm()


def noisy(seed: int, samples: int = 800) -> Problem:
    return make_problem(ARM, multisine_motion(ARM, 0.05, seed, samples))


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


def test_two_links_are_as_exact_as_by_least_squares():
    problem = noisy(1)
    result, plain = AugmentedKalman()(problem), LeastSquares(weights="per_joint")(problem)
    assert (np.abs(result.value - truth(ARM)) < 4 * result.std).all()
    assert (np.abs(result.std / plain.std - 1.2) < 0.5).all()


def test_only_directions_that_the_data_determine():
    model = ARM.with_terms(RotorInertia(ARM.joints))
    result = AugmentedKalman(passes=1)(make_problem(model, multisine_motion(ARM, 0.05, samples=400)))
    assert result.determined.rank < len(model.names)
    assert np.isinf(result.std).any()


def test_too_few_passes_are_said():
    start = noisy(2, 400)
    far = replace(start.motions[0], ddq=1.1 * start.motions[0].ddq)  # least squares is far off
    result = AugmentedKalman(passes=1)(make_problem(ARM, far))
    assert isinstance(result.notes[0], StillMoving)


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


@pytest.mark.parametrize("samples", [4000, 500])
def test_steps_have_the_torque_of_their_samples(samples):
    motion = multisine_motion(ARM)
    problem = make_problem(ARM, motion)
    result = series_of(problem, samples, np.ones(2), (np.zeros((2000, 2)),), (motion.tau,))
    group = group_size(motion, samples)
    assert group == (1 if samples == 4000 else 4)
    assert result.active.all(axis=1).any()
    h = motion.t[1]
    np.testing.assert_allclose(result.step, group * h)
    np.testing.assert_array_equal(result.offset, 0.0)  # the positions of the motion are those that were measured
    np.testing.assert_allclose(result.motion[2, 0, 0], (motion.dq[group] - motion.dq[0]) / (group * h))
    full = (result.mean[0] * result.active[0, :, None]).sum(axis=0) * group * h
    rows = int(result.active[0].sum()) * group
    np.testing.assert_allclose(full, np.trapezoid(motion.tau[: rows + 1], dx=h, axis=0), atol=1e-3)
    np.testing.assert_allclose(result.noise, 1 / np.sqrt(group))


def test_torques_that_are_not_fitted_hardly_count():
    motion = multisine_motion(ARM)
    keep = np.ones((2000, 2), dtype=bool)
    keep[:200, 1] = False
    result = series_of(
        make_problem(ARM, replace(motion, keep=keep)), 4000, np.ones(2), (np.zeros((2000, 2)),), (motion.tau,)
    )
    assert (result.noise[0, :100, 1] > 99).all()
    assert (result.noise[0, :100, 0] == 1).all()


def test_too_short():
    short = multisine_motion(ARM, samples=2000).select_between(stop=0.03)
    with pytest.raises(InputError, match="at least 12"):
        series_of(make_problem(ARM, short), 4000, np.ones(2), (np.zeros((2000, 2)),), (short.tau,))


def test_a_sign_is_uncertain_where_it_may_change_within_a_step():
    model = slider(values=(5.0, 8.0, 3.0, 0.5))
    motion = multisine_motion(model)
    smooth, widths, (uncertain,) = smooth_model(make_problem(model, motion), truth(model), 0.005)
    far = np.abs(motion.dq) > 6 * widths[0]
    assert uncertain[far].max() < 0.01
    assert uncertain[np.abs(motion.dq) < widths[0]].max() > 1.0
    assert smooth is not model


RNG = np.random.default_rng(0)
THETA = np.array(ARM.values)
STEP = np.array([1e-4])


def step_of(step: np.ndarray, motion: np.ndarray, residual: np.ndarray) -> FilterStep:
    return FilterStep(step, motion, residual, np.zeros_like(residual))


def simulated(x: np.ndarray, tau: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """q and dq after a step of the two-link arm, by 20 steps of the midpoint rule."""
    q, dq, h = x[:, :2], x[:, 2:4], STEP[0] / 20
    for _ in range(20):
        middle = dq + h / 2 * ARM.forward_dynamics(q, dq, tau, theta)
        dq, q = dq + h * ARM.forward_dynamics(q + h / 2 * dq, middle, tau, theta), q + h * middle
    return np.concatenate([q, dq], axis=1)


def test_derivatives_are_those_of_the_motion():
    case = Dynamics(ARM, THETA, np.eye(7) * 1e-3, 0.0)
    x, tau = RNG.uniform(-1, 1, (1, 4)), RNG.standard_normal((1, 2))
    after = simulated(x, tau, THETA)
    middle = (x + after) / 2
    motion = np.stack([middle[:, :2], middle[:, 2:], (after - x)[:, 2:] / STEP[0]])
    F, G, c = case.linearise(step_of(STEP, motion, tau - ARM.torque(*motion, THETA)))
    np.testing.assert_allclose(c[0, :4], 0.0, atol=1e-4 * np.abs(after - x).max())
    for k in range(4):
        d = np.eye(4)[[k]] * 1e-4
        by = (simulated(x + d, tau, THETA) - simulated(x - d, tau, THETA))[0] / 2e-4
        np.testing.assert_allclose(F[0, :4, k], by, atol=2e-3 * np.abs(by).max())
    for k in range(7):
        d = np.eye(7)[k] * 1e-4
        by = (simulated(x, tau, THETA + d) - simulated(x, tau, THETA - d))[0] / 0.2
        np.testing.assert_allclose(F[0, :4, 4 + k], by, atol=5e-3 * np.abs(F[0, :4, 4:]).max())
    for k in range(2):
        d = np.eye(2)[[k]] * 1e-2
        by = (simulated(x, tau + d, THETA) - simulated(x, tau - d, THETA))[0] / 2e-2
        np.testing.assert_allclose(G[0, :4, k], by, atol=5e-3 * np.abs(by).max())


@pytest.mark.parametrize("step", [0.01, 10.0])
def test_stiff_friction_is_no_trouble(step):
    """A mass of 1 mg with viscous friction: a velocity is gone after a step, and nothing overflows."""
    model = slider(values=(1e-6, 1.0, 0.0, 0.0))
    still, h = np.zeros((1, 1)), np.array([step])
    F, G, _ = Dynamics(model, np.array(model.values), np.zeros((4, 0)), 0.0).linearise(
        step_of(h, np.zeros((3, 1, 1)), still)
    )
    np.testing.assert_allclose(F[0], [[1.0, 1e-6], [0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(G[0, 0, 0], step, rtol=1e-3)


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
