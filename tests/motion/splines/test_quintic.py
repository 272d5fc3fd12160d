"""The system of the quintic smoothing spline against dense algebra and exact solutions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline, make_interp_spline

from dynident.motion.splines.banded import IllConditionedError
from dynident.motion.splines.quintic import QuinticSystem, local_basis


def system(n: int, wild: float = 0.7, seed: int = 0) -> tuple[QuinticSystem, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    step = 1 + wild * rng.uniform(-1, 1, n - 1)
    step /= step.mean()
    return QuinticSystem(step), np.concatenate(([0.0], np.cumsum(step))), rng.standard_normal(n)


def matrices(of: QuinticSystem, n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.array([of.differences(e) for e in np.eye(n)]).T, np.array([of.mass_times(e) for e in np.eye(n - 3)])


@pytest.mark.parametrize("n", [4, 5, 6, 15])
def test_the_matrices_are_those_of_the_penalty(n: int) -> None:
    """N is half the Gram matrix of quadratic B-splines; Q' y is half their integral with the third derivative."""
    quintic, t, _ = system(n)
    D, N = matrices(quintic, n)
    x, w = np.polynomial.legendre.leggauss(5)
    gram, moments = np.zeros_like(N), np.zeros(n - 3)
    for k in range(n - 1):
        s = t[k] + 0.5 * quintic.step[k] * (1 + x)
        basis = [np.nan_to_num(BSpline.basis_element(t[i : i + 4], extrapolate=False)(s)) for i in range(n - 3)]
        gram += 0.5 * quintic.step[k] * (np.array(basis) * w) @ np.array(basis).T
        moments += 0.5 * quintic.step[k] * np.array(basis) @ (w * 60 * s**2)
    np.testing.assert_allclose(N, gram / 2, atol=1e-14)
    np.testing.assert_allclose(D @ t**5, moments / 2, rtol=1e-9)
    np.testing.assert_allclose(np.array([quintic.spread(e) for e in np.eye(n - 3)]), D, atol=1e-13)


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


def test_derivatives_are_those_of_the_natural_spline() -> None:
    quintic, t, y = system(12)
    _, N = matrices(quintic, 12)
    natural = make_interp_spline(t, y, k=5, bc_type=([(3, 0.0), (4, 0.0)], [(3, 0.0), (4, 0.0)]))
    first, second = quintic.derivatives(y, np.linalg.solve(N, quintic.differences(y)))
    np.testing.assert_allclose(first, natural(t, 1), atol=1e-11)
    np.testing.assert_allclose(second, natural(t, 2), atol=1e-10)


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


@pytest.mark.parametrize(("degree", "repeated"), [(2, 1), (3, 1), (4, 1), (4, 2)])
def test_b_splines_of_every_degree_in_use_are_those_of_scipy_also_at_repeated_knots(degree: int, repeated: int) -> None:
    rng = np.random.default_rng(0)
    inside = np.repeat(np.cumsum(rng.uniform(0.1, 1.0, 6)), np.array([1, 1, repeated, 1, 1, 1]))
    knots = np.concatenate([np.zeros(degree + 1), inside, np.full(degree + 1, inside[-1] + 0.5)])
    t = np.concatenate([np.sort(rng.uniform(0, knots[-1], 60)), [0.0]])
    m = np.searchsorted(knots, t, side="right") - 1
    result, count = local_basis(knots, degree, m, t), len(knots) - degree - 1
    spline = BSpline(knots, np.eye(count), degree)
    for order in range(3):
        zeros = np.zeros((len(t), count))
        zeros[np.arange(len(t))[:, None], m[:, None] - degree + np.arange(degree + 1)] = result[order]
        expected = spline.derivative(order)(t) if order else spline(t)
        np.testing.assert_allclose(zeros, expected, rtol=1e-10, atol=1e-9)
