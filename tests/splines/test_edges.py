"""Where the spline could break: standstill, straight lines, noise and nothing else, numbers out of range."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.errors import InputError
from dynident.splines import GCV, REML, Constraint, Fixed, Interpolation, Rule, smooth

RULES = [Constraint(), Constraint(S=50.0), Fixed(lam=1e-4), Fixed(p=1e3), GCV(), REML(), Interpolation()]


@pytest.mark.parametrize("rule", RULES, ids=repr)
@pytest.mark.parametrize("sigma", [None, 1e-3])
@pytest.mark.parametrize("constant", [0.0, 0.7, 1e-9, 123.456])
@pytest.mark.parametrize("slope", [0.0, 3.3])
@pytest.mark.parametrize("n", [7, 500, 20_000])
def test_a_standstill_and_a_straight_line(
    n: int, slope: float, constant: float, sigma: float | None, rule: Rule
) -> None:
    t = np.arange(n) * 0.002
    y = constant + slope * t
    fit = smooth(t, y, rule, sigma=sigma)
    size = max(np.abs(y).max(), 1e-300)
    np.testing.assert_allclose(fit.values, y, atol=1e-9 * size)
    np.testing.assert_allclose(fit.derivative(1), slope, atol=1e-6 * size / 0.002)
    assert np.isfinite(fit.c).all()


@pytest.mark.parametrize("rule", [GCV(), REML()], ids=repr)
def test_criteria_ignore_a_middle_that_stands_still(rule: GCV | REML) -> None:
    n = 20_000
    t = np.arange(n) * 1e-3
    noise = 1e-3 * np.random.default_rng(0).standard_normal(n)
    moving = np.abs(t - 10.0) > 3.0
    y = np.where(moving, np.sin(t) + noise, np.sin(7.0))
    fit = smooth(t, y, rule)
    assert fit.bandwidth > 5e-4  # jumps of the velocity ask for little smoothing, but not for none
    assert fit.noise < 2e-3


def test_small_samples_and_slow_motion_reach_the_constraint_without_warnings() -> None:
    """Where the noise is nearly all there is, the search must not run away."""
    one = smooth(
        [0, 0.1, 0.2, 0.3], [-0.32605163, 1.48951205, 0.00707818, -0.86067922], Constraint(2.00146018), sigma=1
    )
    assert pytest.approx(2.00146018, rel=1e-8) == one.S
    rng = np.random.default_rng(0)
    for _ in range(300):
        n = int(rng.integers(3, 13))
        S = rng.uniform(0.01, 1.2) * n
        fit = smooth(np.cumsum(rng.uniform(0.1, 1, n)), rng.standard_normal(n), Constraint(S), sigma=1.0)
        assert pytest.approx(S, rel=1e-8) == fit.S or fit.p == 0
    t = np.arange(4000) * 1e-3
    for _ in range(20):
        y = 1e-2 * np.sin(0.3 * t) + 1e-3 * rng.standard_normal(4000)
        fit = smooth(t, y, sigma=1e-3 * rng.uniform(0.7, 0.99))
        assert pytest.approx(4000, rel=1e-8) == fit.S or fit.p == 0


@pytest.mark.parametrize(("t", "y"), [(1e-160, 1.0), (1e160, 1.0), (1.0, 1e160), (1.0, 1e-160)])
def test_numbers_out_of_range_are_refused(t: float, y: float) -> None:
    x = np.linspace(0, 3, 50)
    with pytest.raises(InputError, match="out of range"):
        smooth(t * x, y * np.sin(x))
