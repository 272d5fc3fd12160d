import pytest

from dynident.errors import ConfigError
from dynident.splines import GCV, Constraint, rule_named


def test_rules_have_names() -> None:
    assert rule_named("gcv") == GCV()
    assert rule_named("constraint") == Constraint()
    with pytest.raises(ConfigError, match="no rule 'gvc'; did you mean 'gcv'"):
        rule_named("gvc")
