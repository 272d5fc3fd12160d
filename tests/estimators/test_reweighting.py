"""Rows weighted anew: each step is the weighted least-squares solution, whether rows are kept or computed."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import LeastSquares, Problem
from dynident.estimators.robust_least_squares import BaseRows
from dynident.models.lagrangian import two_link_arm
from dynident.regression import ParallelFilter, Regression, Selection
from dynident.testing.estimator import multisine_motion

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
    for one in (rows, replace(rows, cached_blocks=None)):
        errors = one.errors(np.zeros(7))
        ways.append(one.value(one.step([weights], errors.residuals, joints)[0]))
    weighted = replace(regression, weights=(np.sqrt(weights * joints),))
    np.testing.assert_allclose(ways[0], LeastSquares()(_posed(weighted)).value, rtol=1e-9)
    np.testing.assert_array_equal(*ways)
    assert errors.is_fitted[0].sum() == regression.triangular_factors.total
    assert (errors.residuals[0] != 0).all()  # between the samples of a filter, too


def _posed(regression):
    return Problem(ARM, regression.motions, regression)
