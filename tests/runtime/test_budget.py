"""The budget of memory: what is given holds for a run, else what the environment says."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from dynident.runtime import (
    GIGABYTE,
    MEMORY_VARIABLE,
    BudgetedFunction,
    ConfigError,
    budget_scope,
    format_bytes,
    memory_budget,
    set_budget,
)


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


def test_another_thread_has_it_by_the_function_that_it_is_given() -> None:
    with budget_scope(), ThreadPoolExecutor(1) as thread:
        usual = memory_budget()
        set_budget(2.5)
        assert thread.submit(memory_budget).result() == usual
        assert thread.submit(BudgetedFunction(memory_budget)).result() == 2.5 * GIGABYTE
        assert thread.submit(memory_budget).result() == usual


def test_amounts_in_words() -> None:
    assert [format_bytes(x) for x in (2e6, 99e6, 0.1e9, 4.2e9)] == ["2 MB", "99 MB", "0.1 GB", "4.2 GB"]
