"""Rules of smoothing: what they refuse, and where their criteria look."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.errors import ConfigError
from dynident.splines import GCV, REML, Constraint, rule_named, smooth


def test_rules_have_names() -> None:
    assert rule_named("gcv") == GCV()
    assert rule_named("constraint") == Constraint()
    with pytest.raises(ConfigError, match="no rule 'gvc'; did you mean 'gcv'"):
        rule_named("gvc")


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
