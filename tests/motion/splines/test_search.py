"""Searches for p."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.motion.splines import GCV, REML, Constraint, smooth
from dynident.motion.splines.banded import Grid, IllConditionedError, System, second_difference
from dynident.motion.splines.compiled import BareProblem, Solver, SplineTrial
from dynident.motion.splines.search import (
    SearchPoint,
    _lowest_minimum,
    _parabola_zero,
    _slope_at,
    hermite_root,
    once,
    run_searches,
)
from tests.motion.splines.reference import matrices, series


def test_inverse_hermite_interpolation_is_exact_for_a_cubic() -> None:
    """The search knows (x, error, slope of the error): of x = 2 + 3 e - e^2 + e^3 / 2, the zero of e is at x = 2."""

    def point(e: float) -> tuple[float, float, float]:
        return 2 + 3 * e - e**2 + e**3 / 2, e, 1 / (3 - 2 * e + 1.5 * e**2)

    for a, b in ((0.7, -0.4), (-0.4, 0.7), (0.3, 0.9)):
        assert hermite_root(point(a), point(b)) == pytest.approx(2.0, rel=1e-12)


def test_inverse_interpolation_is_exact_for_a_parabola() -> None:
    reference = [(3 - 2 * s + 0.3 * s * s, 0.0, s) for s in (-1.0, 0.4, 2.0)]
    assert _parabola_zero(reference) == pytest.approx(3.0, rel=1e-12)
    assert np.isnan(_parabola_zero([reference[0], reference[0], reference[1]]))


def test_a_slope_is_continued_by_at_most_a_tenth() -> None:
    point, previous = (3.0, 0.2, -1.0), (2.0, 0.9, -0.8)
    assert _slope_at(3.2, point, previous) == (3.2, pytest.approx(-1.04))
    assert [_slope_at(x, point, previous)[1] for x in (4.0, 2.0)] == pytest.approx([-1.1, -0.9])
    assert _slope_at(3.2, point, None) == (3.0, -1.0)


def points(value: np.polynomial.Polynomial, at: np.ndarray) -> list[SearchPoint]:
    return [(float(x), float(value(x)), float(value.deriv()(x))) for x in at]


def test_the_lower_of_two_valleys_is_found() -> None:
    for tilt in (0.05, -0.05):
        value = np.polynomial.Polynomial([0.0, tilt, -2.0, 0.0, 1.0])  # valleys near -1 and 1
        x, bracket = _lowest_minimum(points(value, np.linspace(-1.7, 1.8, 8)))
        assert x == pytest.approx(-np.sign(tilt), abs=0.1)
        assert bracket is not None
        assert bracket[0][0] < x < bracket[1][0]


def test_an_end_that_is_lower_than_any_valley_is_kept() -> None:
    line = np.polynomial.Polynomial([0.0, 1.0])
    assert _lowest_minimum(points(line, np.arange(5.0))) == (0.0, None)
    assert _lowest_minimum(points(-line, np.arange(5.0))) == (4.0, None)
    fall = np.polynomial.Polynomial([0.0, 0.05, -2.0, 0.0, 1.0])
    assert _lowest_minimum([(-3.0, -5.0, 1.0), *points(fall, np.linspace(-1.7, 1.8, 8))]) == (-3.0, None)


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
