"""The report of a fleet: figures, courses of parameters, tables and pages of any size."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest

from dynident.apps.fleets import (
    Changes,
    ChangeShape,
    History,
    Mark,
    ParameterTrend,
    Scatter,
    residual_groups,
    robots_figure,
    trend_figure,
)
from dynident.apps.fleets.changes_report import RobotTrends, change_words
from dynident.apps.fleets.figures import MAX_POINTS, MAX_SMALL_POINTS
from dynident.apps.fleets.report import fleet_findings, fleet_page, fleet_tables
from dynident.models import Joint
from dynident.regression import GroupKind
from dynident.report.page import plotly_packed
from tests.kept import check_kept
from tests.report.fleets import MEAN, NONE, PAYLOAD, RESIDUAL, SIZE, STD, change, fleet, groups, history

START = datetime(2026, 1, 5)


def course(logs=8):
    """The course of a parameter that steps at day 3."""
    rng = np.random.default_rng(logs)
    days, std = np.arange(logs, dtype=float), rng.uniform(0.1, 0.3, logs)
    files, marks = [f"{k}<b>" for k in range(logs)], (Mark(3.0, "step", (2.0, 3.0)),)
    line = np.array([0.0, 3.0, 3.0, 7.0]), np.array([1.0, 1.0, 2.0, 2.0])
    return ParameterTrend("arm", "Fc", "N m", files, days, 1.0 + std * rng.standard_normal(logs), std, line, marks)


def test_logs_that_do_not_show_a_parameter_are_left_out():
    test_course = course()
    std = np.where(np.arange(8) == 2, np.inf, test_course.std)
    points = trend_figure([replace(test_course, std=std)], START).data[1]
    assert len(points["x"]) == 7
    nothing = replace(test_course, std=np.full(8, np.inf), change_line=None, marks=())
    assert len(trend_figure([nothing], START).data[0]["x"]) == 0
    assert robots_figure([nothing], START).layout["yaxis"].get("range") is None


@pytest.mark.parametrize(("draw", "most"), [(trend_figure, MAX_POINTS), (robots_figure, MAX_SMALL_POINTS)])
def test_of_many_logs_some_are_drawn(draw, most):
    test_course = course(5000)
    points = draw([test_course], START).data[1]
    assert len(points["x"]) == most
    assert points["y"][[0, -1]] == pytest.approx(test_course.value[[0, -1]], rel=1e-6)
    assert points["text"][0].startswith("0&lt;b&gt;")


FRICTION, PAYLOADS, OFFSET = groups()[0], groups()[2], groups()[4]


@pytest.fixture
def stepped():
    """A robot without noise whose payload changes at its log 8, and whose friction drifts from its log 5."""
    test_history = history("arm", 12, noise=0.0)
    load = change(test_history, PAYLOADS, ChangeShape.STEP, 8, [0.4, 0.02, -0.1])
    wear = change(test_history, FRICTION, ChangeShape.DRIFT, 5, [0.0, 2.0])
    part = np.clip((test_history.days - test_history.days[5]) / (test_history.days[-1] - test_history.days[5]), 0, 1)
    value = test_history.value + (np.arange(12) >= 8)[:, None] * (PAYLOAD @ load.size)
    value[:, 1] += 2.0 * part
    return replace(test_history, value=value), (load, wear), part


def test_courses_show_what_is_true(stepped):
    case, changes, part = stepped
    courses = RobotTrends(case, changes, None)
    coulomb = courses.group_trends(FRICTION)[1]
    np.testing.assert_allclose(coulomb.value, MEAN[1] + 2.0 * part, rtol=1e-10)
    np.testing.assert_allclose(coulomb.std, STD[1])
    load = courses.group_trends(PAYLOADS)
    for k, size in enumerate(changes[0].size):
        np.testing.assert_allclose(load[k].value, np.where(np.arange(12) >= 8, size, 0.0), atol=1e-10)
    assert load[0].name == "hand.mass, difference from the mean"
    np.testing.assert_allclose(courses.group_trends(OFFSET)[0].value, MEAN[5])
    assert courses.group_trends(OFFSET)[0].change_line is None


def test_the_line_is_that_of_the_change_and_steps_at_once(stepped):
    case, changes, _ = stepped
    courses = RobotTrends(case, changes, None)
    days, values = courses.group_trends(PAYLOADS)[0].change_line
    assert days.tolist() == sorted(days.tolist())
    at = np.flatnonzero(days == case.days[8])
    np.testing.assert_allclose(values[at], [0.0, 0.4])
    days, values = courses.group_trends(FRICTION)[1].change_line
    np.testing.assert_allclose(np.interp([case.days[5], case.days[-1]], days, values), MEAN[1] + np.array([0.0, 2.0]))
    mark = courses.group_trends(PAYLOADS)[0].marks[0]
    assert (mark.day, mark.word, mark.between) == (case.days[8], "step", (case.days[7], case.days[8]))


def test_intervals_count_the_scatter_and_what_a_log_does_not_show_has_none():
    test_history = history("arm", 6)
    information = test_history.information.copy()
    information[2, 5] = information[2, :, 5] = 0.0
    covariance = np.diag((3 * STD) ** 2)
    scatter = Scatter(tuple(np.arange(SIZE)[:, None]), covariance, 4.0, 50.0)
    std = RobotTrends(replace(test_history, information=information), (), scatter).group_trends(OFFSET)[0].std
    np.testing.assert_allclose(std, np.where(np.arange(6) == 2, np.inf, np.sqrt(4.0 + 9.0) * STD[5]), rtol=1e-8)


def test_a_residual_is_drawn_as_a_torque():
    test_history, group = history("arm", 6), residual_groups((Joint("a"), Joint("b")))[1]
    value = np.log(np.array([[1.0, 2.0]])) + np.linspace(0, 0.3, 6)[:, None]
    left = History(test_history.robot, test_history.logs, test_history.days, value, np.tile(100 * np.eye(2), (6, 1, 1)))
    step = change(left, group, ChangeShape.STEP, 3, [0.2])
    courses = RobotTrends(test_history, (), None, RobotTrends(left, (step,), None))
    assert courses.all_changes == [step]
    (drawn,) = courses.group_trends(group)
    np.testing.assert_allclose(drawn.value, np.exp(value[:, 1]))
    np.testing.assert_allclose(drawn.std, 0.1 * drawn.value)
    assert (drawn.unit, drawn.marks[0].day) == ("N m", test_history.days[3])
    assert drawn.change_line is not None
    np.testing.assert_allclose(drawn.change_line[1][-1] / drawn.change_line[1][0], np.exp(0.2))
    np.testing.assert_allclose(courses.group_trends(OFFSET)[0].value, test_history.value[:, 5])


@pytest.fixture(scope="module")
def fleet_result():
    return fleet()


def own(page):
    """The page without plotly's script."""
    return page.replace(plotly_packed(), "")


def test_words_follow_what_is_certain():
    test_history, ripple, before = history("arm-0"), replace(FRICTION, kind=GroupKind.RIPPLE), np.array([-2.0, 3.0])
    sizes = [0.0, 1.0], [-1.0, 0.0], [-1.0, 1.0], [1.0, 1.0], [0.01, 0.02]  # where none is certain, the clearest
    changes = [(change(test_history, FRICTION, shape, 8, size), before) for shape in ChangeShape for size in sizes]
    hidden = change(test_history, FRICTION, ChangeShape.STEP, 8, [9.0, 1.0], std=np.array([np.inf, 0.1]))
    for size in ([-3.0, 4.0], [3.0, -2.0], [3.0, 4.0], [0.0, 0.0]):  # a ripple rises by its size, whatever its phase
        changes += [(change(test_history, ripple, ChangeShape.DRIFT, 8, size), x) for x in (before, np.full(2, np.nan))]
    lines = (change_words(x, START, zero) for x, zero in (*changes, (hidden, before)))
    check_kept("fleet_words", "\n".join(lines))


def test_torque_that_the_model_leaves_is_worded_with_what_to_do_and_drawn(fleet_result):
    """Of a joint of a robot whose payload changed, too; as a torque, with a rise of its logarithm in percent."""
    left = [
        History(x.robot, x.logs, x.days, np.full((20, 2), np.log(0.5)), np.tile(400 * np.eye(2), (20, 1, 1)))
        for x in fleet_result.histories
    ]
    group = residual_groups(fleet_result.base.joints)[1]
    rise = change(left[0], group, ChangeShape.STEP, 8, [np.log(1.5)], std=np.array([0.02]), p_value=0.0005)
    changes = replace(
        fleet_result.changes[0], changes=(*fleet_result.changes[0].changes, rise), residual_scatter=RESIDUAL
    )
    made = replace(fleet_result, residuals=tuple(left), changes=(changes,))
    assert "residual by +50.0 +- 3.0 %. No term of the recipe describes this" in fleet_findings(made)[0]
    fell = replace(changes, changes=(replace(rise, size=-rise.size),))
    assert fleet_findings(replace(made, changes=(fell,)))[0].endswith(": residual by -33.3 +- 1.3 %.")
    page = own(fleet_page(made))
    assert page.count("torque that the model leaves at elbow rose") >= 2  # in words and below the figure
    assert "+50.0 +- 3.0 %" in str(fleet_tables(made)[0].rows)


@pytest.mark.parametrize(("robots", "logs"), [(10, 260), (500, 6)])
def test_a_page_of_thousands_of_logs_stays_small_and_says_what_it_leaves_out(robots, logs):
    page = own(fleet_page(fleet(robots, logs)))
    assert len(page) < 3e6
    assert page.count('href="./runs') <= 2500
    assert "`fleet.parquet` has all" in page.replace("<code>", "`").replace("</code>", "`")
    if robots == 500:
        assert "Drawn are 48 of 500 robots" in page
        assert "of the first 300 robots" in page


def test_many_changes_are_counted_and_few_are_drawn():
    made = fleet(60, 8)
    some = [change(x, FRICTION, ChangeShape.STEP, 4, [1.0, 0.0]) for x in made.histories]
    made = replace(made, changes=(Changes(0.01, tuple(some), {x.robot: 0.0 for x in some}, (), NONE),))
    assert "The table of the report has 54 more changes." in fleet_findings(made)
    page = own(fleet_page(made))
    assert "The changes of 20 more robots are in the table above only." in page
    assert len(fleet_tables(made)[0].rows) == 20
    assert fleet_tables(made)[0].caption == "Changes, worst first, the 20 worst of 60"
