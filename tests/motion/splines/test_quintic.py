"""The system of the quintic smoothing spline against dense algebra and exact solutions."""

import numpy as np
import pytest

from dynident.motion.splines.banded import IllConditionedError
from dynident.motion.splines.quintic import QuinticSystem


def system(n: int, wild: float = 0.7, seed: int = 0) -> tuple[QuinticSystem, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    step = 1 + wild * rng.uniform(-1, 1, n - 1)
    step /= step.mean()
    return QuinticSystem(step), np.concatenate(([0.0], np.cumsum(step))), rng.standard_normal(n)


def matrices(of: QuinticSystem, n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.array([of.differences(e) for e in np.eye(n)]).T, np.array([of.mass_times(e) for e in np.eye(n - 3)])


@pytest.mark.parametrize("n", [4, 5, 6, 40])
@pytest.mark.parametrize("p", [1e-8, 1e-3, 1.0, 1e4])
def test_solves_the_dense_system(n: int, p: float) -> None:
    quintic, _, y = system(n)
    D, N = matrices(quintic, n)
    A = D @ D.T + p * N
    z = quintic.differences(y)
    u = np.linalg.solve(A, z)
    solution = quintic.solve(p, y)
    np.testing.assert_allclose(solution.u, u, rtol=1e-8, atol=1e-9 * np.abs(u).max())
    np.testing.assert_allclose(solution.g, y - quintic.spread(u), atol=1e-9)
    assert solution.penalised_rss == pytest.approx(z @ u, rel=1e-9)
    assert solution.log_det == pytest.approx(np.linalg.slogdet(A)[1], abs=1e-9)


@pytest.mark.parametrize("m", [3, 100, 1000])
def test_bandwidths_of_thousands_of_samples_keep_their_digits(m: int) -> None:
    """On a circle of samples the gain at w is 1 / (1 + lam w^6); in the middle of long data as well."""
    n = 70 * m
    t = np.arange(n) - n // 2
    w, p = 0.5 / m, 0.5 / m**6
    solution = QuinticSystem(np.ones(n - 1)).solve(p, np.cos(w * t))
    first, second = QuinticSystem(np.ones(n - 1)).derivatives(solution.g, p * solution.u)
    discrete = 2 * np.sin(w / 2)
    aliased = sum((w + 2 * np.pi * k) ** -6 for k in range(-3, 4)) * discrete**6
    gain = aliased / (aliased + discrete**6 / (2 * p))
    middle = np.abs(t) < m
    np.testing.assert_allclose(solution.g[middle], gain * np.cos(w * t[middle]), atol=1e-7)
    np.testing.assert_allclose(second[middle] / w**2, -gain * np.cos(w * t[middle]), atol=1e-4 / m**1.5 + 2e-6)
    np.testing.assert_allclose(first[middle] / w, -gain * np.sin(w * t[middle]), atol=1e-4 / m**1.5 + 2e-6)


def test_what_double_precision_cannot_solve_is_said() -> None:
    step = np.ones(20)
    step[::3] = 1e-120
    with pytest.raises(IllConditionedError), np.errstate(all="ignore"):
        QuinticSystem(step).solve(1e-3, np.sin(np.arange(21) * 0.1))
