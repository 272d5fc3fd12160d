"""Splines at given times, kept for recordings to come."""

import numpy as np
import pytest

from dynident.estimators.maximum_likelihood import SplineTrajectory
from dynident.estimators.maximum_likelihood.trajectory import MAX_CACHED_TIMES, basis

T = np.linspace(0.0, 1.0, 41)


def test_the_same_times_and_knots_share_one_basis() -> None:
    one = basis(SplineTrajectory(np.linspace(0, 1, 6)), T, from_rest=True)
    assert basis(SplineTrajectory(np.linspace(0, 1, 6)), T.copy(), from_rest=True) is one
    for other in (
        basis(SplineTrajectory(np.linspace(0, 1, 7)), T, from_rest=True),
        basis(SplineTrajectory(np.linspace(0, 1, 6), (0.4,)), T, from_rest=True),
        basis(SplineTrajectory(np.linspace(0, 1, 6)), T + 1e-12, from_rest=True),
        basis(SplineTrajectory(np.linspace(0, 1, 6)), T, from_rest=False),
    ):
        assert other is not one


def test_large_ones_are_not_kept() -> None:
    trajectory, t = SplineTrajectory(np.linspace(0, 1, 6)), np.linspace(0, 1, MAX_CACHED_TIMES + 1)
    assert basis(trajectory, t, from_rest=False) is not basis(trajectory, t, from_rest=False)


@pytest.mark.parametrize("rest", [False, True])
def test_its_products_are_those_of_its_values(rest: bool) -> None:
    one = basis(SplineTrajectory(np.linspace(0, 1, 6)), T, from_rest=rest)
    C = np.random.default_rng(0).standard_normal((one.trajectory.size, 2))
    q, dq, _ = one.motion(C)
    np.testing.assert_allclose(one.values @ C, q, atol=1e-14)
    np.testing.assert_allclose(one.by_interval(q).sum(axis=0), q.sum(axis=0))
    whole = (one.values.T @ one.values).toarray()
    np.testing.assert_allclose(one.products.toarray(), whole, atol=1e-14)
    for d, row in enumerate(one.gram_band):
        np.testing.assert_allclose(row[: len(row) - d], np.diagonal(whole, -d), atol=1e-14)
    assert (np.abs(dq[0]) < 1e-12).all() == rest
