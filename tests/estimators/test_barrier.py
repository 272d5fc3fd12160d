"""The barrier: where it ends, and Newton's method inside of it."""

import numpy as np
import pytest

from dynident.estimators import Barrier, PenalisedQuadratic, PsdConstraint


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def random_demand(rng: np.random.Generator) -> PsdConstraint:
    """Return a demand on three matrices (2, 2) of four numbers, met at (9, 0, 0, 0)."""
    half = rng.standard_normal((3, 2, 2, 4))
    slopes = half + half.swapaxes(1, 2)
    slopes[..., 0] = np.eye(2)
    return PsdConstraint(slopes, offset=0.5 * np.eye(2) + np.zeros((3, 2, 2)))


def test_outside_it_is_infinite_and_has_no_slopes(rng: np.random.Generator) -> None:
    barrier = Barrier((random_demand(rng),))
    outside = np.array([-9.0, 0, 0, 0])
    assert barrier.value(outside) == np.inf
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        barrier.derivatives(outside)


def bodies(rng: np.random.Generator, count: int = 3) -> Barrier:
    """Return a barrier of pseudo-inertias (4, 4), ten numbers each, and of as many numbers that must be positive."""
    v, result = 11 * count, []
    for k in range(count):
        slopes = np.zeros((4, 4, v))
        for at, (i, j) in enumerate(zip(*np.triu_indices(4), strict=True)):
            slopes[i, j, 10 * k + at] = slopes[j, i, 10 * k + at] = 1.0
        centre = rng.standard_normal((4, 6))
        result.append(PsdConstraint(slopes[None], (centre @ centre.T)[None]))
        result.append(PsdConstraint(np.eye(v)[10 * count + k].reshape(1, 1, 1, v)))
    return Barrier(tuple(result), 1e-3)


def thin(barrier: Barrier, size: float) -> np.ndarray:
    """Return a point whose matrices have eigenvalues of this size beside those of one."""
    rod = np.diag([1.0, 1.0, size, size])[np.triu_indices(4)]
    count = len(barrier.psd_constraints) // 2
    return np.concatenate([np.tile(rod, count), np.full(count, size)])


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-7, 1e-11])
def test_the_minimum_is_reached_however_near_the_boundary_the_start_is(rng: np.random.Generator, size: float) -> None:
    """The data see some directions only, and pull far beyond the boundary."""
    barrier = bodies(rng)
    origin = thin(barrier, size)
    half = rng.standard_normal((20, len(origin)))
    H, g = half.T @ half, half.T @ (100 * rng.standard_normal(20))
    near = barrier.restrict(origin, np.eye(len(origin)))
    x = near.minimum(H, g, 1e-10)
    assert near.is_inside(x)
    assert PenalisedQuadratic(H, g, ((near, near.weight),)).newton(x)[1] < 1e-12
