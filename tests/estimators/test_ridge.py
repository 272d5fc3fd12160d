"""Ridge regression: its closed form, the strength by cross-validation, and intervals that hold."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import LeastSquares, PhysicallyConsistent, Ridge
from dynident.estimators.notes import DrawnToPrior
from dynident.estimators.ridge import _usual_sizes
from dynident.models import Joint, Model
from dynident.models.friction import Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Motion
from dynident.runtime import ConfigError
from dynident.testing.estimator import make_problem, multisine_motion, truth


def weak(seed: int = 0, samples: int = 400, speed: float = 0.05, noise: float = 0.3):
    """The arm hardly moves, and its torque is noisy: inertias are poorly determined."""
    model = two_link_arm()
    made = multisine_motion(model, 0.0, seed, samples)
    q, dq, ddq = 0.5 * made.q, speed * made.dq, speed * made.ddq
    tau = model.torque(q, dq, ddq, truth(model)) + noise * np.random.default_rng(seed).standard_normal(q.shape)
    return make_problem(model, replace(made, q=q, dq=dq, ddq=ddq, tau=tau))


def test_closed_form():
    """(X'X + K)^-1 (X'y + K prior), K = strength rss / size^2."""
    problem = weak()
    model, plain = problem.model, LeastSquares(weights="per_joint")(problem)
    w, triangular = plain.residual.weights, problem.regression.triangular_factors
    size = _usual_sizes(model, triangular, w)
    factor = triangular.stack(w)
    X, y, prior = factor[:-1, :-1], factor[:-1, -1], 1.1 * truth(model)
    K = np.diag(0.3 * factor[-1, -1] ** 2 / size**2)
    result = Ridge(dict(zip(model.names, prior, strict=True)), 0.3)(problem)
    np.testing.assert_allclose(result.value, np.linalg.solve(X.T @ X + K, X.T @ y + K @ prior), rtol=1e-8)
    moved = result.value - plain.value
    np.testing.assert_allclose(result.covariance, plain.covariance + np.outer(moved, moved), rtol=1e-6, atol=1e-12)


def test_a_parameter_without_a_value_is_of_the_size_that_explains_the_whole_torque():
    t = np.arange(100.0)
    dq = np.sin(t)[:, None]
    motion = Motion(t, dq, dq, dq, 3 * dq + 1, ("a",), dq[:, 0] < 2)
    problem = make_problem(Model((Viscous((Joint("a"),)),)), motion)
    size = _usual_sizes(problem.model, problem.regression.triangular_factors, np.ones(1))
    np.testing.assert_allclose(size, np.linalg.norm(motion.tau) / np.linalg.norm(dq))


def test_strength_by_cross_validation():
    """A right prior helps where the data are weak, a wrong one is left out, and strong data need none."""
    problem = weak()
    right = Ridge("nominal")(problem)
    (note,) = right.notes
    assert isinstance(note, DrawnToPrior)
    assert note.strength > 0
    plain = LeastSquares(weights="per_joint")(problem)
    off = [np.abs((x.value - truth(problem.model)) / plain.std).max() for x in (right, plain)]
    assert off[0] < off[1]
    strong = make_problem(problem.model, multisine_motion(problem.model, 0.05))
    wrong = {name: 5.0 * value for name, value in zip(problem.model.names, truth(problem.model), strict=True)}
    for estimator in (Ridge(wrong), Ridge("none"), Ridge("nominal")):
        estimate = estimator(strong)
        assert estimate.notes == ()
        np.testing.assert_allclose(estimate.value, LeastSquares(weights="per_joint")(strong).value, rtol=1e-6)


@pytest.mark.parametrize("strength", [0.01, 1.0])
def test_intervals_hold_where_the_prior_is_wrong(strength):
    """95 % of the intervals of each parameter hold, with constraints, too; where the prior is off by some standard
    errors of least squares, those by the errors of the drawn fit alone do not."""
    inside = []
    for seed in range(40):
        problem = weak(seed)
        prior = dict(zip(problem.model.names, 1.5 * truth(problem.model), strict=True))
        ridge = Ridge(prior, strength)
        for estimator in (ridge, PhysicallyConsistent(fit=ridge, costs=False)):
            estimate = estimator(problem)
            inside.append(np.abs(estimate.value - truth(problem.model)) < 1.96 * estimate.std)
    assert np.mean(inside, axis=0).min() > 0.86  # of 40 recordings: 2.6 standard deviations below 0.95


def test_wrong_settings_are_named():
    with pytest.raises(ConfigError, match="prior of J"):
        Ridge(prior={"J": np.nan})
    with pytest.raises(ConfigError, match="has no parameter 'x'"):
        Ridge({"x": 1.0})(weak())
    assert Ridge({"x": 1.0, "y": 2.0}).among(["y"]).named == ("y",)
