"""The systems of the cubic and the quintic smoothing spline against dense algebra and exact solutions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline, make_interp_spline

from dynident.motion.splines.banded import Grid, IllConditionedError, System, second_difference
from dynident.motion.splines.quintic import QuinticSystem
from tests.motion.splines.reference import grid, matrices


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("kind", ["uniform", "wild"])
@pytest.mark.parametrize("n", [3, 4, 5, 40])
def test_figures_are_those_of_dense_algebra(n: int, kind: str, weighted: bool) -> None:
    """rss with its slope, and log det with both derivatives, are exact: no differences."""
    rng = np.random.default_rng(n)
    t = grid(n, 1.0, kind)
    step = np.diff(t) / np.diff(t).mean()
    t = np.concatenate(([0.0], np.cumsum(step)))
    variance = rng.uniform(0.3, 3, n) if weighted else None
    D, N, Q = matrices(t, np.ones(n) if variance is None else np.sqrt(variance))
    y = rng.standard_normal(n)
    for p in (1e-4, 0.1, 30.0):
        system, z = System(Grid(step), variance), second_difference(y, step)
        found, refined = system.solve(p, z, refine=False, trace=True), system.solve(p, z)
        A = Q.T @ D**2 @ Q + p * N
        u = np.linalg.solve(A, Q.T @ y)
        share = p * np.linalg.solve(A, N)
        rss = float(np.sum((D @ Q @ u) ** 2))
        slope = -2 * p * (u @ N @ u - u @ N @ share @ u) / rss
        expected = [rss, slope, u @ N @ u, np.linalg.slogdet(A)[1], np.trace(share), np.trace(share - share @ share)]
        got = [found.rss, found.slope, found.energy, found.log_det, found.rise, found.bend]
        np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(refined.rss, rss, rtol=1e-9)
        np.testing.assert_allclose(refined.u, u, atol=1e-10 * np.abs(u).max())


def test_a_grid_that_is_too_wide_breaks_down() -> None:
    with pytest.raises(IllConditionedError, match=r"broke down|refinement stops"):
        System(Grid(np.diff(1e-6 * np.arange(60_000)) * 1e6)).solve(
            0.5 / 20_000.0**4, np.sin(40e-6 * np.arange(59_998))
        )


def system(n: int, wild: float = 0.7, seed: int = 0) -> tuple[QuinticSystem, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    step = 1 + wild * rng.uniform(-1, 1, n - 1)
    step /= step.mean()
    return QuinticSystem(step), np.concatenate(([0.0], np.cumsum(step))), rng.standard_normal(n)


def quintic_matrices(of: QuinticSystem, n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.array([of.differences(e) for e in np.eye(n)]).T, np.array([of.mass_times(e) for e in np.eye(n - 3)])


@pytest.mark.parametrize("n", [4, 5, 6, 15])
def test_the_matrices_are_those_of_the_penalty(n: int) -> None:
    """N is half the Gram matrix of quadratic B-splines; Q' y is half their integral with the third derivative."""
    quintic, t, _ = system(n)
    D, N = quintic_matrices(quintic, n)
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
    D, N = quintic_matrices(quintic, n)
    A = D @ D.T + p * N
    z = quintic.differences(y)
    u = np.linalg.solve(A, z)
    found = quintic.solve(p, y)
    np.testing.assert_allclose(found.u, u, rtol=1e-8, atol=1e-9 * np.abs(u).max())
    np.testing.assert_allclose(found.g, y - quintic.spread(u), atol=1e-9)
    assert found.penalised_rss == pytest.approx(z @ u, rel=1e-9)
    assert found.log_det == pytest.approx(np.linalg.slogdet(A)[1], abs=1e-9)


def test_derivatives_are_those_of_the_natural_spline() -> None:
    quintic, t, y = system(12)
    _, N = quintic_matrices(quintic, 12)
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
    found = QuinticSystem(np.ones(n - 1)).solve(p, np.cos(w * t))
    first, second = QuinticSystem(np.ones(n - 1)).derivatives(found.g, p * found.u)
    discrete = 2 * np.sin(w / 2)
    aliased = sum((w + 2 * np.pi * k) ** -6 for k in range(-3, 4)) * discrete**6
    gain = aliased / (aliased + discrete**6 / (2 * p))
    middle = np.abs(t) < m
    np.testing.assert_allclose(found.g[middle], gain * np.cos(w * t[middle]), atol=1e-7)
    np.testing.assert_allclose(second[middle] / w**2, -gain * np.cos(w * t[middle]), atol=1e-4 / m**1.5 + 2e-6)
    np.testing.assert_allclose(first[middle] / w, -gain * np.sin(w * t[middle]), atol=1e-4 / m**1.5 + 2e-6)


def test_what_double_precision_cannot_solve_is_said() -> None:
    step = np.ones(20)
    step[::3] = 1e-120
    with pytest.raises(IllConditionedError), np.errstate(all="ignore"):
        QuinticSystem(step).solve(1e-3, np.sin(np.arange(21) * 0.1))
