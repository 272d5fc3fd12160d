"""Rules of smoothing: what they refuse, and where their criteria look."""

import numpy as np
import pytest

from dynident.motion.splines import GCV, REML, Constraint, Fixed, Interpolation, Rule, rule_by_name, smooth
from dynident.runtime import ConfigError
from tests.motion.splines.reference import series


def test_rules_have_names() -> None:
    assert rule_by_name("gcv") == GCV()
    assert rule_by_name("constraint") == Constraint()
    with pytest.raises(ConfigError, match="no rule 'gvc'; did you mean 'gcv'"):
        rule_by_name("gvc")


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


def columns(n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    t, rng = np.arange(n) * 0.01, np.random.default_rng(2)
    return t, np.column_stack([np.sin(3 * t), 2 * np.cos(2 * t)]) + 0.01 * rng.standard_normal((n, 2))


@pytest.mark.parametrize("rule", [Constraint(S=[1.0, 2.0, 3.0]), Fixed(p=[1.0, 2.0, 3.0]), Fixed(lam=[1.0, 2.0, 3.0])])
def test_settings_for_more_columns_than_there_are(rule: Rule) -> None:
    t, y = columns()
    with pytest.raises(ConfigError, match="has 3 entries, but the data have 2 columns"):
        smooth(t, y, rule, sigma=1.0)
    with pytest.raises(ConfigError, match="S has no entries"):
        smooth(t, y, Constraint(S=[]), sigma=1.0)


@pytest.mark.parametrize("weighted", [False, True])
def test_a_straight_line_is_returned_just_where_it_satisfies_the_constraint(weighted: bool) -> None:
    t, y = columns()
    weights = np.random.default_rng(0).uniform(0.5, 2.0, len(t)) if weighted else np.ones(len(t))
    line = np.polyval(np.polyfit(t, y[:, 0], 1, w=np.sqrt(weights)), t)
    S = float(np.sum(weights * ((y[:, 0] - line) / 0.01) ** 2))
    enough, less = (
        smooth(t, y[:, 0], Constraint(S=S * share), sigma=0.01, weights=weights if weighted else None)
        for share in (1 + 1e-9, 1 - 1e-4)
    )
    assert enough.p == 0
    assert pytest.approx(S, rel=1e-9) == enough.S
    np.testing.assert_allclose(enough.values, line, atol=1e-11)
    assert less.p > 0
    assert pytest.approx(S * (1 - 1e-4), rel=1e-8) == less.S


@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_a_line_is_straight_to_within_rounding_and_no_more(offset: float) -> None:
    """Noise of 1e-9 on a line is no rounding error, nor is any that is 100 times the last digit."""
    t = np.arange(300) * 0.01
    noise = np.random.default_rng(0).standard_normal(300)
    for rule in (Constraint(S=100.0), GCV(), REML()):
        straight = smooth(t, offset + 2 * t, rule, sigma=1e-13)
        assert straight.p == 0
        size = max(1e-9, 100 * np.spacing(offset))
        assert smooth(t, offset + 2 * t + size * noise, rule, sigma=0.5 * size).p > 0
    assert smooth(t, offset + 2 * t, Constraint(S=1.0), sigma=1e-20).p == 0


def test_the_limits_of_a_given_p() -> None:
    t, y = columns()
    through = smooth(t, y, Interpolation())
    for rule in (Fixed(p=np.inf), Fixed(lam=0.0)):
        np.testing.assert_array_equal(smooth(t, y, rule).c, through.c)
    np.testing.assert_array_equal(smooth(t, y, Fixed(lam=np.inf)).p, 0.0)
    np.testing.assert_allclose(smooth(t, y, Fixed(p=0.5)).values, smooth(t, y, Fixed(lam=1.0)).values, rtol=1e-14)
    with pytest.raises(ConfigError, match=r"p is nan; it must be a number >= 0"):
        smooth(t, y, Fixed(p=np.nan))


@pytest.mark.parametrize("S", [1e-6, 1.0, 150.0, 300.0, 900.0])
@pytest.mark.parametrize("kind", ["uniform", "jittered", "wild"])
def test_reaches_the_constraint(kind: str, S: float) -> None:
    t, y = series(kind=kind)
    fit = smooth(t, y, Constraint(S=S), sigma=1e-2)
    assert np.sum(((fit.values - y) / 1e-2) ** 2) == pytest.approx(S, rel=1e-8)
    assert pytest.approx(S, rel=1e-8) == fit.S
