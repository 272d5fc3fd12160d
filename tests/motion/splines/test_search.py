"""Searches for p."""

import numpy as np
import pytest

from dynident.motion.splines import GCV, REML, Constraint, smooth
from dynident.motion.splines.banded import Grid, IllConditionedError, System, second_difference
from dynident.motion.splines.compiled import BareProblem, Solver, SplineTrial
from dynident.motion.splines.search import once, run_searches
from tests.motion.splines.reference import matrices, series


@pytest.mark.parametrize("rule", [GCV(), REML()], ids=repr)
def test_the_least_criterion_is_found_to_many_digits(rule: GCV | REML) -> None:
    """The slope of the criterion, in dense algebra, changes its sign within 1e-5 of the p found, and nowhere else."""
    t, y = series(n=100)
    _, N, Q = matrices(t, np.ones(len(t)))
    _, s, v = np.linalg.svd(np.linalg.cholesky(N).T @ np.linalg.inv(np.linalg.cholesky(Q.T @ Q).T))
    z = v @ np.linalg.solve(np.linalg.cholesky(Q.T @ Q), Q.T @ y)

    def slope(p: float) -> float:
        share = p * s**2 / (1 + p * s**2)
        kept = (1 - share) * z
        if isinstance(rule, REML):
            return float(share.mean() - np.sum(kept * share * z) / np.sum(kept * z))
        return float(
            -2 * np.sum(kept**2 * share) / np.sum(kept**2) + 2 * np.sum(share * (1 - share)) / np.sum(1 - share)
        )

    p = float(smooth(t, y, rule).p)
    assert (
        max(slope(p * x) for x in (1e-3, 0.1, 0.8, 1 - 1e-5)) < 0 < min(slope(p * x) for x in (1 + 1e-5, 1.25, 10, 1e3))
    )


def test_an_error_of_one_search_is_its_own() -> None:
    system = System(Grid(np.diff(1e-6 * np.arange(60_000)) * 1e6))
    bad = BareProblem(system, second_difference(np.sin(40e-6 * np.arange(60_000)), system.step))
    with pytest.raises(IllConditionedError):
        run_searches([once(bad, 1e-2), once(bad, 0.5 / 20_000.0**4)])
    assert [run_search.p for run_search in run_searches([once(bad, 1e-2), once(bad, 1.0)])] == [1e-2, 1.0]


@pytest.mark.parametrize("n", [1000, 4000, 20_000])
def test_few_trials_reach_the_constraint(monkeypatch: pytest.MonkeyPatch, n: int) -> None:
    asked: list[SplineTrial] = []
    solve = Solver.__call__
    monkeypatch.setattr(Solver, "__call__", lambda self, trials: asked.extend(trials) or solve(self, trials))
    t = np.arange(n) * 1e-3
    y = np.sin(t) + 0.5 * np.sin(3.1 * t) + 1e-3 * np.random.default_rng(0).standard_normal(n)
    y = np.column_stack([y, y])  # a single series is searched in the kernel
    fit = smooth(t, y, Constraint(), sigma=1e-3)
    assert pytest.approx(n, rel=1e-10) == np.max(fit.S)
    assert sum(x.series.system.size == n - 2 for x in asked) <= 2 * 9
    asked.clear()
    smooth(t, y, GCV())
    assert sum(x.series.system.size == n - 2 for x in asked) <= 2 * (12 + 7)


@pytest.mark.parametrize("seed", [4, 9, 14, 16, 24])
def test_steps_of_very_different_lengths_reach_the_constraint(seed: int) -> None:
    """There a solution misses its sum by more before it is refined than p may be corrected for."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(np.where(rng.random(150) < 0.1, 1e-6, 0.01))
    fit = smooth(t, np.sin(t) + 0.001 * rng.standard_normal(150), Constraint(), sigma=0.001)
    assert pytest.approx(150, rel=1e-6) == fit.S
