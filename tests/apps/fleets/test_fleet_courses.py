from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.fleets import ChangeShape, History, Scatter, residual_groups
from dynident.apps.fleets.changes_report import RobotTrends
from dynident.apps.fleets.components import VarianceComponents
from dynident.models import Joint
from tests.report.fleets import MEAN, PAYLOAD, SIZE, STD, change, groups, history

FRICTION, PAYLOADS, OFFSET = groups()[0], groups()[2], groups()[4]


@pytest.fixture
def stepped():
    """A robot without noise whose payload changes at its log 8, and whose friction drifts from its log 5."""
    one = history("arm", 12, noise=0.0)
    load = change(one, PAYLOADS, ChangeShape.STEP, 8, [0.4, 0.02, -0.1])
    wear = change(one, FRICTION, ChangeShape.DRIFT, 5, [0.0, 2.0])
    part = np.clip((one.days - one.days[5]) / (one.days[-1] - one.days[5]), 0, 1)
    value = one.value + (np.arange(12) >= 8)[:, None] * (PAYLOAD @ load.size)
    value[:, 1] += 2.0 * part
    return replace(one, value=value), (load, wear), part


def test_courses_show_what_is_true(stepped):
    one, changes, part = stepped
    courses = RobotTrends(one, changes, None)
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
    one, changes, _ = stepped
    courses = RobotTrends(one, changes, None)
    days, values = courses.group_trends(PAYLOADS)[0].change_line
    assert days.tolist() == sorted(days.tolist())
    at = np.flatnonzero(days == one.days[8])
    np.testing.assert_allclose(values[at], [0.0, 0.4])
    days, values = courses.group_trends(FRICTION)[1].change_line
    np.testing.assert_allclose(np.interp([one.days[5], one.days[-1]], days, values), MEAN[1] + np.array([0.0, 2.0]))
    mark = courses.group_trends(PAYLOADS)[0].marks[0]
    assert (mark.day, mark.word, mark.between) == (one.days[8], "step", (one.days[7], one.days[8]))


def test_intervals_count_the_scatter():
    one = history("arm", 6)
    covariance = np.diag((3 * STD) ** 2)
    scatter = Scatter(VarianceComponents(tuple(np.arange(SIZE)[:, None]), covariance, 4.0), 50.0)
    std = RobotTrends(one, (), scatter).group_trends(OFFSET)[0].std
    np.testing.assert_allclose(std, np.sqrt(4.0 + 9.0) * STD[5], rtol=1e-8)


def test_what_a_log_does_not_show_has_no_value():
    one = history("arm", 6)
    information = one.information.copy()
    information[2, 5] = information[2, :, 5] = 0.0
    std = RobotTrends(replace(one, information=information), (), None).group_trends(OFFSET)[0].std
    assert np.isinf(std).tolist() == [k == 2 for k in range(6)]


def test_units_do_not_matter():
    """Parameters in other units give the same courses, in these units."""
    one = history("arm", 6)
    scale = 10.0 ** np.arange(-4, SIZE - 4)
    other = replace(one, value=one.value * scale, information=one.information / np.outer(scale, scale))
    group = replace(FRICTION, directions=scale[:, None] * FRICTION.directions)
    for a, b in zip(
        RobotTrends(one, (), None).group_trends(FRICTION), RobotTrends(other, (), None).group_trends(group), strict=True
    ):
        np.testing.assert_allclose(a.std, b.std)
        np.testing.assert_allclose(a.value, b.value)


def test_a_residual_is_drawn_as_a_torque():
    one, group = history("arm", 6), residual_groups((Joint("a"), Joint("b")))[1]
    value = np.log(np.array([[1.0, 2.0]])) + np.linspace(0, 0.3, 6)[:, None]
    left = History(one.robot, one.logs, one.days, value, np.tile(100 * np.eye(2), (6, 1, 1)))
    step = change(left, group, ChangeShape.STEP, 3, [0.2])
    courses = RobotTrends(one, (), None, RobotTrends(left, (step,), None))
    assert courses.all_changes == [step]
    (drawn,) = courses.group_trends(group)
    np.testing.assert_allclose(drawn.value, np.exp(value[:, 1]))
    np.testing.assert_allclose(drawn.std, 0.1 * drawn.value)
    assert (drawn.unit, drawn.marks[0].day) == ("N m", one.days[3])
    assert drawn.change_line is not None
    np.testing.assert_allclose(drawn.change_line[1][-1] / drawn.change_line[1][0], np.exp(0.2))
    np.testing.assert_allclose(courses.group_trends(OFFSET)[0].value, one.value[:, 5])
