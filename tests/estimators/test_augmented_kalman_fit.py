"""Kalman filtering of parameters: as maximum likelihood within its errors, honest, and clear where it fails."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.article.article import arm_to_identify
from dynident.estimators import AugmentedKalman, LeastSquares, Problem
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.estimators.notes import StillMoving
from dynident.models import RotorInertia
from dynident.models.friction import Dahl
from dynident.models.lagrangian import pendulum, two_link_arm
from dynident.models.simulation import record, simulate
from dynident.motion.smoothers import Spline
from dynident.regression import Regression
from dynident.runtime import ConfigError, InputError
from dynident.testing.estimator import make_problem, multisine_motion, truth

ARM = two_link_arm()


def noisy(seed: int, samples: int = 800) -> Problem:
    return make_problem(ARM, multisine_motion(ARM, 0.05, seed, samples))


def recorded(seed: int, samples: int = 801) -> Problem:
    arm, t = pendulum(), np.arange(samples) * 0.01
    motion = simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    log = record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=np.random.default_rng(seed)).log
    smooth = Spline(sigma=1e-4)(log)
    return Problem(arm, (smooth,), Regression(arm, (smooth,)), (log,))


def test_as_maximum_likelihood():
    problem = recorded(0)
    found, best = AugmentedKalman()(problem), MaximumLikelihood()(problem)
    assert (np.abs(found.value - best.value) < 3 * found.std).all()
    assert (found.std > 0.7 * best.std).all()
    assert found.information is not None


def test_intervals_hold():
    """95 % of them, with noise in positions and torque."""
    inside = []
    for seed in range(8):
        problem = recorded(seed, 401)
        found = AugmentedKalman(passes=1)(problem)
        inside.append(np.abs(found.value - problem.model.values) < 1.96 * found.std)
    assert np.mean(inside) > 0.75  # of 16: 3.7 standard deviations below 0.95


def test_two_links_are_as_exact_as_by_least_squares():
    problem = noisy(1)
    found, plain = AugmentedKalman()(problem), LeastSquares(weights="per_joint")(problem)
    assert (np.abs(found.value - truth(ARM)) < 4 * found.std).all()
    assert (np.abs(found.std / plain.std - 1.2) < 0.5).all()


def test_only_directions_that_the_data_determine():
    model = ARM.with_terms(RotorInertia(ARM.joints))
    found = AugmentedKalman(passes=1)(make_problem(model, multisine_motion(ARM, 0.05, samples=400)))
    assert found.determined.rank < len(model.names)
    assert np.isinf(found.std).any()


def test_too_few_passes_are_said():
    start = noisy(2, 400)
    far = replace(start.motions[0], ddq=1.1 * start.motions[0].ddq)  # least squares is far off
    found = AugmentedKalman(passes=1)(make_problem(ARM, far))
    assert isinstance(found.notes[0], StillMoving)


def test_divergence_is_said():
    motion = multisine_motion(ARM, 0.01, samples=400)
    wrong = replace(motion, tau=0 * motion.tau)  # so that least squares finds no mass
    with pytest.raises(InputError, match="Kalman filter diverged"):
        AugmentedKalman()(make_problem(arm_to_identify(), wrong))


def test_terms_that_remember_are_refused():
    model = ARM.with_terms(Dahl(ARM.joints, length=0.1))
    motion = model.remembering(multisine_motion(ARM, samples=100))
    with pytest.raises(ConfigError, match="remember"):
        AugmentedKalman()(make_problem(model, motion))
