"""The banded system against dense algebra."""

import numpy as np
import pytest

from dynident.motion.splines.banded import Grid, IllConditionedError, System, second_difference
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
        solution, refined = system.solve(p, z, refine=False, trace=True), system.solve(p, z)
        A = Q.T @ D**2 @ Q + p * N
        u = np.linalg.solve(A, Q.T @ y)
        share = p * np.linalg.solve(A, N)
        rss = float(np.sum((D @ Q @ u) ** 2))
        slope = -2 * p * (u @ N @ u - u @ N @ share @ u) / rss
        expected = [rss, slope, u @ N @ u, np.linalg.slogdet(A)[1], np.trace(share), np.trace(share - share @ share)]
        got = [solution.rss, solution.slope, solution.energy, solution.log_det, solution.rise, solution.bend]
        np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(refined.rss, rss, rtol=1e-9)
        np.testing.assert_allclose(refined.u, u, atol=1e-10 * np.abs(u).max())


def test_a_grid_that_is_too_wide_breaks_down() -> None:
    with pytest.raises(IllConditionedError, match=r"broke down|refinement stops"):
        System(Grid(np.diff(1e-6 * np.arange(60_000)) * 1e6)).solve(
            0.5 / 20_000.0**4, np.sin(40e-6 * np.arange(59_998))
        )
