"""Splines at given times, kept for recordings to come."""

import numpy as np
import pytest

from dynident.estimators.maximum_likelihood import Trajectory
from dynident.estimators.maximum_likelihood.basis import LONG, basis

T = np.linspace(0.0, 1.0, 41)


def test_the_same_times_and_knots_share_one_basis() -> None:
    one = basis(Trajectory(np.linspace(0, 1, 6)), T, rest=True)
    assert basis(Trajectory(np.linspace(0, 1, 6)), T.copy(), rest=True) is one
    for other in (
        basis(Trajectory(np.linspace(0, 1, 7)), T, rest=True),
        basis(Trajectory(np.linspace(0, 1, 6), (0.4,)), T, rest=True),
        basis(Trajectory(np.linspace(0, 1, 6)), T + 1e-12, rest=True),
        basis(Trajectory(np.linspace(0, 1, 6)), T, rest=False),
    ):
        assert other is not one


def test_large_ones_are_not_kept() -> None:
    trajectory, t = Trajectory(np.linspace(0, 1, 6)), np.linspace(0, 1, LONG + 1)
    assert basis(trajectory, t, rest=False) is not basis(trajectory, t, rest=False)


@pytest.mark.parametrize("rest", [False, True])
def test_its_products_are_those_of_its_values(rest: bool) -> None:
    one = basis(Trajectory(np.linspace(0, 1, 6)), T, rest=rest)
    C = np.random.default_rng(0).standard_normal((one.trajectory.size, 2))
    q, dq, _ = one.motion(C)
    np.testing.assert_allclose(one.values @ C, q, atol=1e-14)
    np.testing.assert_allclose(one.by_interval(q).sum(axis=0), q.sum(axis=0))
    whole = (one.values.T @ one.values).toarray()
    np.testing.assert_allclose(one.products.toarray(), whole, atol=1e-14)
    for d, row in enumerate(one.gram_band):
        np.testing.assert_allclose(row[: len(row) - d], np.diagonal(whole, -d), atol=1e-14)
    assert (np.abs(dq[0]) < 1e-12).all() == rest
