"""The report of a fleet: figures, tables and pages of any size."""

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
    residual_groups,
    robots_figure,
    trend_figure,
)
from dynident.apps.fleets.changes_report import change_words
from dynident.apps.fleets.figures import MAX_POINTS, MAX_SMALL_POINTS
from dynident.apps.fleets.report import fleet_findings, fleet_page, fleet_tables
from dynident.regression import GroupKind
from dynident.report.page import plotly_packed
from tests.kept import check_kept
from tests.report.fleets import NONE, RESIDUAL, change, fleet, groups, history

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


FRICTION = groups()[0]


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
