"""A matrix with a band and a border that does not determine a trajectory."""

import numpy as np
import pytest

from dynident.estimators.maximum_likelihood.trajectory import Arrow
from dynident.runtime import ModelError


def test_the_band_of_the_inverse_is_that_of_the_whole_inverse() -> None:
    m, w = 9, 3
    lower = np.tril(np.triu(np.random.default_rng(0).normal(size=(m, m)), 1 - w)) + 5 * np.eye(m)
    both = lower @ lower.T, np.linalg.inv(lower @ lower.T)
    band, expected = (np.stack([np.append(np.diagonal(x, -d), np.zeros(d)) for d in range(w)]) for x in both)
    np.testing.assert_allclose(Arrow(band, np.zeros((m, 1))).inverse, expected, atol=1e-14)


def test_what_is_not_determined_is_refused() -> None:
    with pytest.raises(ModelError, match="not determined"):
        Arrow(np.zeros((2, 5)), np.zeros((5, 1))).solve_band(np.ones((5, 1)))
