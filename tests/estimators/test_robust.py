"""Robust least squares: known minima, wrong torques, and standard errors that hold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from dynident.estimators import LeastSquares, Problem, RobustLeastSquares
from dynident.estimators.notes import Downweighted
from dynident.estimators.robust_least_squares import BaseRows
from dynident.identification.uncertainty import identifiability_of
from dynident.models import Joint, Model
from dynident.models.friction import Offset
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Motion
from dynident.regression import ParallelFilter, Regression, Selection
from dynident.testing.estimator import make_problem, multisine_motion, truth

LOSSES = ("huber", "tukey")
every_loss = pytest.mark.parametrize("loss", LOSSES)


def spoilt(motion: Motion, share: float, seed: int = 0, size: float = 3.0, *, one_sided: bool = False) -> Motion:
    """A motion with that share of its torques wrong, all of them with the velocity where ``one_sided``."""
    rng = np.random.default_rng(seed)
    wrong, by = rng.random(motion.tau.shape) < share, rng.normal(0, size, motion.tau.shape)
    by = np.abs(by) * np.sign(motion.dq) if one_sided else by
    return replace(motion, tau=np.where(wrong, motion.tau + by, motion.tau))


def location(y: np.ndarray) -> Problem:
    """The problem whose only parameter is the mean of y."""
    joints = (Joint("one", "prismatic"),)
    model, zero = Model((Offset(joints),)), np.zeros((len(y), 1))
    mask = np.ones(len(y), dtype=bool)
    return make_problem(model, Motion(np.arange(len(y)) * 0.01, zero, zero, zero, y[:, None], ("one",), mask))


@every_loss
def test_location(loss):
    """The mean of a sample is Huber's or Tukey's location: the minimum of the loss at the scale of the residuals."""
    y = np.concatenate([np.random.default_rng(1).normal(2.0, 0.1, 90), np.full(10, 9.0)])
    result = RobustLeastSquares(loss)(location(y))
    c = {"huber": 1.345, "tukey": 4.685}[loss]

    def total(mean: float, scale: float) -> float:
        u = np.abs(y - mean) / scale
        if loss == "huber":
            return float(np.where(u <= c, u**2 / 2, c * u - c**2 / 2).sum())
        return float((1 - (1 - np.minimum(u / c, 1.0) ** 2) ** 3).sum())

    scale = np.median(np.abs(y - result.value)) / 0.6744897501960817
    best = minimize_scalar(total, (1.9, 2.1), args=(scale,), options={"xtol": 1e-12})
    np.testing.assert_allclose(result.value, best.x, atol=2e-4)
    assert result.notes == (Downweighted((("one", float(np.mean(result.residual.sample_weights[0] ** 2 < 0.5))),)),)


@pytest.mark.parametrize("one_sided", [False, True], ids=["any", "one-sided"])
@every_loss
def test_every_tenth_torque_wrong(loss, one_sided):
    """Intervals hold the truth in 95 % of the runs, by all standard errors; those of Huber's loss where wrong torques
    lie on both sides."""
    model, inside = two_link_arm(), []
    for seed in range(20):
        problem = make_problem(model, spoilt(multisine_motion(model, 0.05, seed, 500), 0.1, seed, one_sided=one_sided))
        result = RobustLeastSquares(loss)(problem)
        rows = replace(problem.regression, weights=result.residual.sample_weights)
        wide = identifiability_of(rows, result, np.zeros((7, 7)))[0].std
        inside.append([np.abs(result.value - truth(model)) < 1.96 * std for std in (result.std, wide)])
        plain = LeastSquares()(problem)
        assert (result.std < 0.2 * plain.std).all()
        np.testing.assert_allclose(result.residual.sigma, 0.05, rtol=0.4)
    covered = np.mean(inside, axis=(0, 2))
    assert (covered > 0.9).all() == (loss == "tukey" or not one_sided), covered  # 140 intervals: 0.9 is 2.7 deviations


ARM = two_link_arm()


@pytest.mark.parametrize("parallel_filter", [None, ParallelFilter(decimate=3)], ids=["all", "filter"])
def test_a_step_is_to_the_weighted_solution(parallel_filter):
    motion = multisine_motion(ARM, 0.05, samples=500)
    motion = replace(motion, keep=np.random.default_rng(1).random((500, 2)) < 0.9)
    regression = Regression(ARM, (motion,), Selection(parallel_filter))
    rank = LeastSquares().reduced(_posed(regression)).directions
    rows = BaseRows.of(regression, np.array(ARM.values), rank)
    weights, joints = np.random.default_rng(0).random((500, 2)), np.array([1.0, 4.0])
    ways = []
    for case in (rows, replace(rows, cached_blocks=None)):
        errors = case.errors(np.zeros(7))
        ways.append(case.value(case.step([weights], errors.residuals, joints)[0]))
    weighted = replace(regression, weights=(np.sqrt(weights * joints),))
    np.testing.assert_allclose(ways[0], LeastSquares()(_posed(weighted)).value, rtol=1e-9)
    np.testing.assert_array_equal(*ways)
    assert errors.is_fitted[0].sum() == regression.triangular_factors.total
    assert (errors.residuals[0] != 0).all()  # between the samples of a filter, too


def _posed(regression):
    return Problem(ARM, regression.motions, regression)
