"""Logs that are not what they are taken for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from dynident.apps.fleets import History, find_changes
from dynident.apps.fleets.components import scatter_of
from dynident.apps.fleets.doubts import (
    _duplicate_warnings,
    _misfit_warnings,
    _rest_warnings,
    _simultaneous_change_warnings,
    common_groups,
)
from dynident.regression import GroupKind, ParameterGroup
from tests.apps.fleets.simulated import FRICTION_A, GROUPS, OFFSET_B, SIZE, fleet


def together(histories: list[History], rng: np.random.Generator) -> tuple[ParameterGroup, ...]:
    return common_groups(histories, GROUPS, scatter_of(histories, GROUPS, rng), rng)


def later(index: int, size: float):
    def change(log: int, value: np.ndarray) -> None:
        value[index] += size * SIZE[index] * (log >= 5)

    return change


def test_quiet_robots_have_nothing_in_common() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        assert together(fleet(rng, 6, 8), rng) == ()


def test_a_change_of_all_robots_at_once_is_named() -> None:
    rng = np.random.default_rng(1)
    histories = fleet(rng, 8, 10, dict.fromkeys(range(8), later(9, 0.2)))
    assert find_changes(histories, GROUPS, rng).changes == ()  # it hides in the scatter
    assert together(histories, rng) == (GROUPS[OFFSET_B],)


def test_the_temperature_of_the_day_is_named() -> None:
    rng = np.random.default_rng(2)
    warm = rng.standard_normal(10)

    def change(log: int, value: np.ndarray) -> None:
        value[4:6] *= 1 + 0.3 * warm[log]

    assert together(fleet(rng, 6, 10, dict.fromkeys(range(6), change)), rng) == (GROUPS[FRICTION_A],)


@pytest.mark.parametrize(("robots", "logs"), [(0, 0), (1, 8), (2, 8), (5, 1)])
def test_of_few_robots_nothing_is_said(robots: int, logs: int) -> None:
    rng = np.random.default_rng(3)
    histories = fleet(rng, robots, logs)
    scatter = scatter_of(fleet(rng, 4, 8), GROUPS, rng)
    assert common_groups(histories, GROUPS, scatter, rng) == ()


def test_the_same_recording_under_two_names_is_named() -> None:
    one, two = fleet(np.random.default_rng(4), 2, 3)
    assert list(_duplicate_warnings([one, two])) == []
    value = two.value.copy()
    value[2] = one.value[0]
    (words,) = _duplicate_warnings([one, replace(two, value=value)])
    assert "log0 (robot0) = log2 (robot1)" in words


def test_a_log_at_rest_is_named() -> None:
    one, two = fleet(np.random.default_rng(5), 2, 3)
    assert list(_rest_warnings([one, two])) == []
    information = one.information.copy()
    shown = np.isin(np.arange(len(SIZE)), [8, 9])
    information[1] = np.where(np.outer(shown, shown), information[1], 0.0)
    (words,) = _rest_warnings([replace(one, information=information), two])
    assert words.endswith("as at rest: log1 (robot0).")
    assert list(_rest_warnings([])) == []


def test_a_robot_of_which_everything_changes_with_one_log_is_doubted() -> None:
    rng = np.random.default_rng(6)

    def swapped(log: int, value: np.ndarray) -> None:
        value *= 1 if log < 5 else 3

    found = find_changes(fleet(rng, 6, 8, {2: swapped}), GROUPS, rng)
    (words,) = _simultaneous_change_warnings(found, len(GROUPS))
    assert words.startswith("robot2: ")
    assert "log5" in words
    found = find_changes(fleet(rng, 6, 8, {2: later(9, 1.0)}), GROUPS, rng)
    assert [one.group.kind for one in found.changes] == [GroupKind.OFFSET]
    assert list(_simultaneous_change_warnings(found, len(GROUPS))) == []


def test_logs_that_fit_far_worse_than_others_of_their_type_are_named() -> None:
    errors = {"a": [1.0, 1.2, 2.9, 4.0, 1.2, 1.2, None], "b": [30.0, 33.0]}
    status = {True: "ok", False: "failed"}
    rows = [
        {"robot": f"r{k}", "type": kind, "log": f"{k}.csv", "date": k, "status": status[bool(error)], "error": error}
        for kind, some in errors.items()
        for k, error in enumerate(some)
    ]
    assert list(_misfit_warnings(pl.DataFrame(rows[:3]))) == []
    (words,) = _misfit_warnings(pl.DataFrame(rows))
    assert "more than 3 times the median: 3.csv (r3), 4 %." in words
