"""Standard errors from the scores of parts: by hand, and by how often their intervals hold."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.regression import ParallelFilter, Regression, Selection, divide_regression, factors_of_parts
from dynident.runtime import ModelError
from dynident.validation import clustered_std, plain_std
from tests.validation.test_hac import MODEL, fit, motion


def test_they_are_the_sandwich_of_the_scores() -> None:
    regression = Regression(MODEL, (motion(0, 0.9), motion(1, 0.9)), Selection(ParallelFilter(cutoff=20.0)))
    parts = divide_regression(regression, 100)
    factors, w = factors_of_parts(regression, parts), np.array([1.0, 0.3])
    theta = fit(regression)
    bread, middle = 0.0, 0.0
    for part in parts:
        rows = [block.scale_rows(w[:, None]) for block in regression.entries(within=(part.motion, part.rows))]
        u = sum(np.einsum("bjp,bj->p", one.regressor(), (one.tau - one.torque(theta)).T) for one in rows)
        bread = bread + sum(np.einsum("bji,bjk->ik", one.regressor(), one.regressor()) for one in rows)
        middle = middle + np.outer(u, u)
    inverse, count = np.linalg.inv(bread), len(parts)
    expected = np.sqrt(count / (count - 1) * np.diag(inverse @ middle @ inverse))
    np.testing.assert_allclose(clustered_std(lambda: factors, regression, theta, w), expected, rtol=1e-9)
    some = clustered_std(lambda: factors, regression, theta, w, [0, 3])
    alone = np.linalg.inv(bread[np.ix_([0, 3], [0, 3])])  # type: ignore[index]
    few = np.sqrt(count / (count - 1) * np.diag(alone @ middle[np.ix_([0, 3], [0, 3])] @ alone))  # type: ignore[index]
    np.testing.assert_allclose(some, few, rtol=1e-9)
    off = regression.subtract_bias(0.1 * theta)  # what is subtracted is no residual
    np.testing.assert_allclose(clustered_std(lambda: factors, off, 0.9 * theta, w), expected, rtol=1e-9)


def test_intervals_hold_where_residuals_are_correlated_within_parts() -> None:
    truth, inside, plain = np.array([2.0, 3.0, 1.0, -1.0]), [], []
    for seed in range(60):
        regression = Regression(MODEL, (motion(seed, 0.9, 4000),))
        theta, factors = fit(regression), factors_of_parts(regression, divide_regression(regression, 100))
        off = np.abs(theta - truth)
        inside.append(off < 1.96 * clustered_std(lambda one=factors: one, regression, theta))  # type: ignore[misc]
        plain.append(off < 1.96 * plain_std(regression, theta, np.ones(2), range(4)))
    assert 0.88 < np.mean(inside) < 0.98
    assert np.mean(plain) < 0.5


def test_one_part_is_too_few() -> None:
    regression = Regression(MODEL, (motion(0, 0.5),))
    whole = regression.triangular_factors
    with pytest.raises(ModelError, match="at least two"):
        clustered_std(lambda: [whole], regression, fit(regression))
