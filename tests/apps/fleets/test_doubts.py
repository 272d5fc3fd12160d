"""Residuals that change by themselves, and logs that are not what they are taken for."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from scipy.stats import binom

import dynident as dy
from dynident.apps.fleets import ChangeShape, History, find_changes
from dynident.apps.fleets.components import scatter_of
from dynident.apps.fleets.doubts import (
    _misfit_warnings,
    _rest_warnings,
    _simultaneous_change_warnings,
    common_groups,
    find_changes_and_residuals,
)
from dynident.apps.fleets.report import fleet_findings
from dynident.models import Joint
from dynident.regression import GroupKind, ParameterGroup
from tests.apps.fleets.made import FLEET, RECIPE, write_log
from tests.apps.fleets.simulated import FRICTION_A, GROUPS, OFFSET_B, SIZE, carries, fleet

JOINTS = Joint("a"), Joint("b"), Joint("rail", "prismatic")
FEW_DRAWS = {"rate": 0.05, "draws": 200}  # the smaller the rate, the more draws
SAMPLES, DAILY = 1000.0, 0.06  # of a log; how much residuals differ from log to log


def residuals(rng, histories, changes=None):
    """What the model leaves: half a newton metre or so; ``changes`` by robot add to the logarithm (n) of a log."""
    result, n = [], len(JOINTS)
    for r, case in enumerate(histories):
        k = len(case.logs)
        value = np.log(0.5) + 0.3 * rng.standard_normal(n) + DAILY * rng.standard_normal((k, n))
        value += np.array([(changes or {}).get(r, lambda log: np.zeros(n))(log) for log in range(k)])
        result.append(History(case.robot, case.logs, case.days, value, np.tile(2 * SAMPLES * np.eye(n), (k, 1, 1))))
    return result


def grows(log: int) -> np.ndarray:
    return np.array([0.0, 0.05 * max(log - 5, 0), 0.0])


def steps(log: int) -> np.ndarray:
    return 0.4 * (log >= 10) * np.ones(3)


@pytest.mark.parametrize(
    ("robots", "logs", "fleets", "odd_logs", "has_residuals"),
    [(10, 3, 10, 0.0, False), (2, 12, 10, 0.0, False), (12, 12, 3, 0.05, True), (3, 4, 8, 0.0, True)],
)
def test_quiet_robots_are_flagged_no_more_often_than_said(
    robots: int, logs: int, fleets: int, odd_logs: float, has_residuals: bool
) -> None:
    """Of 180 robots in all; more than these counts had a probability of 1e-3 at the rate stated. Odd logs have errors
    five times as large: tails that the fleet shows raise no alarms."""
    rng, chances, flagged, rate = np.random.default_rng(robots * logs), [], 0, 0.05
    for _ in range(fleets):
        histories = fleet(rng, robots, logs)
        for history in histories:
            mean, odd = history.value.mean(axis=0), rng.random(logs) < odd_logs
            history.value[odd] = mean + 5 * (history.value[odd] - mean)
        left = residuals(rng, histories) if has_residuals else []
        changes = find_changes_and_residuals(histories, GROUPS, left, JOINTS, rng, rate=rate, draws=60)
        chances += changes.p_values.values()
        flagged += len({change.robot for change in changes.changes})
        assert changes.rate == rate
    assert len(chances) == robots * fleets
    assert flagged <= sum(chance <= rate for chance in chances) <= binom.ppf(0.999, len(chances), rate)
    assert has_residuals or sum(chance <= 0.3 for chance in chances) <= binom.ppf(0.999, len(chances), 0.3)


def test_a_residual_that_grows_is_found_at_its_joint_beside_a_change_of_parameters() -> None:
    rng = np.random.default_rng(1)
    histories = fleet(rng, 10, 16, {4: carries})
    left = residuals(rng, histories, {2: grows, 7: grows})
    changes = find_changes_and_residuals(histories, GROUPS, left, JOINTS, rng, **FEW_DRAWS)
    assert {(change.robot, change.group.kind, change.group.joint) for change in changes.changes} == {
        ("robot2", GroupKind.RESIDUAL, "b"), ("robot4", GroupKind.PAYLOAD, "b"), ("robot7", GroupKind.RESIDUAL, "b")
    }  # fmt: skip
    (change,) = changes.of("robot2")
    assert abs(change.size[0] - 0.5) < 4 * change.std[0]
    assert changes.p_values["robot2"] == change.p_value < 0.01
    assert abs(np.sqrt(changes.residual_scatter.covariance[1, 1]) - DAILY) < 0.02


@pytest.mark.parametrize(("delay", "kinds"), [(0, ["payload"]), (4, ["payload", "residual"])])
def test_a_residual_that_a_change_of_parameters_explains_is_left_out(delay: int, kinds: list[str]) -> None:
    rng = np.random.default_rng(2)
    histories = fleet(rng, 10, 18, {4: carries})
    changes = find_changes_and_residuals(
        histories, GROUPS, residuals(rng, histories, {4: lambda log: steps(log - delay)}), JOINTS, rng, **FEW_DRAWS
    )
    assert sorted({str(x.group.kind) for x in changes.of("robot4")}) == kinds
    assert len(changes.changes) == len(changes.of("robot4"))


def test_friction_of_another_joint_explains_nothing() -> None:
    rng = np.random.default_rng(3)

    def rubs(log: int, value: np.ndarray) -> None:
        value[4:6] *= 1.6 if log >= 10 else 1.0

    histories = fleet(rng, 10, 16, {4: rubs})
    left = residuals(rng, histories, {4: steps})
    changes = find_changes_and_residuals(histories, GROUPS, left, JOINTS, rng, **FEW_DRAWS)
    joints = sorted(x.group.joint for x in changes.of("robot4") if x.group.kind is GroupKind.RESIDUAL)
    assert joints == ["b", "rail"]
    assert GROUPS[FRICTION_A] in [x.group for x in changes.of("robot4")]


def test_without_residuals_all_of_the_rate_is_that_of_the_parameters() -> None:
    histories = fleet(np.random.default_rng(4), 6, 10, {2: carries})
    changes = find_changes_and_residuals(histories, GROUPS, [], JOINTS, np.random.default_rng(0), rate=0.1, draws=50)
    other = find_changes(histories, GROUPS, np.random.default_rng(0).spawn(1)[0], rate=0.1, draws=100)
    assert changes.p_values == other.p_values
    assert changes.residual_scatter is None


def test_a_ripple_that_the_recipe_does_not_have_is_flagged_at_its_joint(tmp_path: Path) -> None:
    """Three robots with four logs; a ripple of 0.3 N m in the end, beside friction of 0.6 N m."""
    for robot in range(3):
        for k in range(4):
            path = write_log(tmp_path, f"arm-{robot}", f"2026-01-{k + 1:02}", 10 * robot + k + 50)
            if robot == 1:
                ripple = 0.1 * k * (12 * pl.col("q2")).sin()
                pl.read_csv(path).with_columns(tau2=pl.col("tau2") + ripple).write_csv(path)
    (tmp_path / "robot.yaml").write_text(RECIPE)
    (tmp_path / "fleet.yaml").write_text(FLEET + "false_alarms: 0.05\n")  # the smaller, the more draws
    test_fleet = dy.fleet(tmp_path / "fleet.yaml", tmp_path / "out")
    changes = test_fleet.changes[0].changes
    assert {(change.robot, change.group.kind, change.group.joint) for change in changes} == {
        ("arm-1", GroupKind.RESIDUAL, "elbow")
    }
    assert changes[0].size[0] > np.log(3)
    words = fleet_findings(test_fleet)[0]
    assert words.startswith("arm-1: torque that the model leaves at elbow ")
    assert "recipe.yaml" in words
    assert "torque that the model leaves at elbow" in (tmp_path / "out" / "report.html").read_text()
    assert test_fleet.residuals[1].value.shape == (4, 2)


def together(histories: list[History], rng: np.random.Generator) -> tuple[ParameterGroup, ...]:
    return common_groups(histories, GROUPS, scatter_of(histories, GROUPS, rng), rng)


def later(index: int, size: float):
    def change(log: int, value: np.ndarray) -> None:
        value[index] += size * SIZE[index] * (log >= 5)

    return change


def test_quiet_robots_have_nothing_in_common() -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        assert together(fleet(rng, 6, 8), rng) == ()


def test_a_change_of_all_robots_at_once_is_named() -> None:
    rng = np.random.default_rng(1)
    histories = fleet(rng, 8, 10, dict.fromkeys(range(8), later(9, 0.2)))
    assert find_changes(histories, GROUPS, rng).changes == ()  # it hides in the scatter
    assert together(histories, rng) == (GROUPS[OFFSET_B],)


@pytest.mark.parametrize(("robots", "logs"), [(0, 0), (1, 8), (2, 8), (5, 1)])
def test_of_few_robots_nothing_is_said(robots: int, logs: int) -> None:
    rng = np.random.default_rng(3)
    histories = fleet(rng, robots, logs)
    scatter = scatter_of(fleet(rng, 4, 8), GROUPS, rng)
    assert common_groups(histories, GROUPS, scatter, rng) == ()


def test_a_log_at_rest_is_named() -> None:
    case, two = fleet(np.random.default_rng(5), 2, 3)
    assert list(_rest_warnings([case, two])) == []
    information = case.information.copy()
    shown = np.isin(np.arange(len(SIZE)), [8, 9])
    information[1] = np.where(np.outer(shown, shown), information[1], 0.0)
    (words,) = _rest_warnings([replace(case, information=information), two])
    assert words.endswith("as at rest: log1 (robot0).")
    assert list(_rest_warnings([])) == []


@pytest.mark.parametrize(
    ("changed", "groups", "doubted"),
    [(1, 2, False), (2, 2, True), (2, 3, True), (2, 4, False), (3, 4, True), (2, 9, False), (3, 9, True)],
)
def test_a_log_is_doubted_where_most_of_what_can_change_does(changed: int, groups: int, doubted: bool) -> None:
    steps = [
        SimpleNamespace(shape=ChangeShape.STEP, robot="r", since="log5", group=SimpleNamespace(kind=kind, joint="a"))
        for kind in list(GroupKind)[:changed]
    ]
    warnings = list(_simultaneous_change_warnings(SimpleNamespace(changes=steps), groups))
    assert len(warnings) == doubted
    assert all(words.startswith("r: ") and "log5" in words for words in warnings)


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


def test_the_temperature_of_the_day_is_named() -> None:
    rng = np.random.default_rng(2)
    warm = rng.standard_normal(10)

    def change(log: int, value: np.ndarray) -> None:
        value[4:6] *= 1 + 0.3 * warm[log]

    assert together(fleet(rng, 6, 10, dict.fromkeys(range(6), change)), rng) == (GROUPS[FRICTION_A],)
