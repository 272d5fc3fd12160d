"""The budget of memory: what is given holds for a run, else what the environment says."""

import pytest

from dynident.runtime import GIGABYTE, MEMORY_VARIABLE, ConfigError, budget_scope, memory_budget, set_budget


def test_what_is_given_holds_inside_and_comes_before_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(MEMORY_VARIABLE, raising=False)
    usual = memory_budget()
    monkeypatch.setenv(MEMORY_VARIABLE, "0.5")
    assert memory_budget() == 0.5 * GIGABYTE < usual
    with budget_scope():
        set_budget(2.0)
        with budget_scope():
            assert memory_budget() == 2 * GIGABYTE
            set_budget(3.0)
        assert memory_budget() == 2 * GIGABYTE
    assert memory_budget() == 0.5 * GIGABYTE
    for wrong in ("much", "0", "-1", "nan", "inf"):
        monkeypatch.setenv(MEMORY_VARIABLE, wrong)
        with pytest.raises(ConfigError, match=f"DYNIDENT_MEMORY is '{wrong}'; give a positive number of GB"):
            memory_budget()
