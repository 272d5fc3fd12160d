"""The central path: from any feasible start, however near the boundary, to where Newton's method ends at once."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.estimators import Barrier, PenalisedQuadratic, PsdConstraint
from dynident.estimators import barrier as central_path
from dynident.estimators.barrier import INITIAL_WEIGHT_SHARE, follow_central_path, solver


def bodies(rng: np.random.Generator, count: int = 3) -> Barrier:
    """Return a barrier of pseudo-inertias (4, 4), ten numbers each, and of as many numbers that must be positive."""
    v, found = 11 * count, []
    for k in range(count):
        slopes = np.zeros((4, 4, v))
        for at, (i, j) in enumerate(zip(*np.triu_indices(4), strict=True)):
            slopes[i, j, 10 * k + at] = slopes[j, i, 10 * k + at] = 1.0
        centre = rng.standard_normal((4, 6))
        found.append(PsdConstraint(slopes[None], (centre @ centre.T)[None]))
        found.append(PsdConstraint(np.eye(v)[10 * count + k].reshape(1, 1, 1, v)))
    return Barrier(tuple(found), 1e-3)


def thin(barrier: Barrier, size: float) -> np.ndarray:
    """Return a point whose matrices have eigenvalues of this size beside those of one."""
    rod = np.diag([1.0, 1.0, size, size])[np.triu_indices(4)]
    count = len(barrier.psd_constraints) // 2
    return np.concatenate([np.tile(rod, count), np.full(count, size)])


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-7, 1e-11])
def test_it_ends_where_one_step_of_newton_is_left(rng: np.random.Generator, size: float) -> None:
    """The data see some directions only, and pull far beyond the boundary."""
    barrier = bodies(rng)
    origin = thin(barrier, size)
    half = rng.standard_normal((20, len(origin)))
    H, g = half.T @ half, half.T @ (100 * rng.standard_normal(20))
    near = barrier.restrict(origin, np.eye(len(origin)))
    pull = g - near.weight * near.linear_gradient
    task = PenalisedQuadratic(H, g, ((near, near.weight),))
    weight = INITIAL_WEIGHT_SHARE * task.newton(np.zeros(len(g)))[1] / len(barrier.psd_constraints)
    x = follow_central_path(H, pull, near.matrices, np.zeros(len(g)), (weight, near.weight))
    assert near.is_inside(x)
    assert task.newton(x)[1] < 0.1 * near.weight
    settled, fall = task.minimise(x, 1e-10, 6)
    assert fall < 1e-10
    assert task.newton(settled)[1] < 1e-12


def test_the_minimum_takes_few_steps(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    taken, step = [0], central_path._step

    def counted(*given):
        taken[0] += 1
        return step(*given)

    monkeypatch.setattr(central_path, "_step", counted)
    barrier = bodies(rng)
    origin = thin(barrier, 1e-6)
    half = rng.standard_normal((20, len(origin)))
    x = barrier.restrict(origin, np.eye(len(origin))).minimum(
        half.T @ half, half.T @ (100 * rng.standard_normal(20)), 1e-9
    )
    assert barrier.is_inside(origin + x)
    assert 0 < taken[0] < 60


def test_a_singular_matrix_is_inverted_on_its_range(rng: np.random.Generator) -> None:
    half = rng.standard_normal((3, 5))
    H, g = half.T @ half, half.T @ rng.standard_normal(3)
    np.testing.assert_allclose(H @ solver(H)(g), g, rtol=1e-8)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
