"""The budget of memory: what is given holds for a run, else what the environment says."""

from __future__ import annotations

import pytest

from dynident.errors import GIGABYTE, MEMORY, ConfigError, amount, budgeted, give, memory


def test_what_is_given_holds_inside_and_comes_before_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(MEMORY, raising=False)
    usual = memory()
    monkeypatch.setenv(MEMORY, "0.5")
    assert memory() == 0.5 * GIGABYTE < usual
    with budgeted():
        give(2.0)
        with budgeted():
            assert memory() == 2 * GIGABYTE
            give(3.0)
        assert memory() == 2 * GIGABYTE
    assert memory() == 0.5 * GIGABYTE
    monkeypatch.setenv(MEMORY, "much")
    with pytest.raises(ConfigError, match="DYNIDENT_MEMORY is 'much'; give a positive number of GB"):
        memory()


def test_amounts_in_words() -> None:
    assert [amount(one) for one in (2e6, 99e6, 0.1e9, 4.2e9)] == ["2 MB", "99 MB", "0.1 GB", "4.2 GB"]
