from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from dynident.apps.fleets import Mark, ParameterTrend, pooled_figure, robots_figure, trend_figure
from dynident.apps.fleets.figures import MAX_POINTS, MAX_SMALL_POINTS

START = datetime(2026, 1, 5)
MARKS = (Mark(3.0, "step", (2.0, 3.0)),)


def course(logs=8, robot="arm", marks=MARKS, **changes):
    rng = np.random.default_rng(logs)
    days, std = np.arange(logs, dtype=float), rng.uniform(0.1, 0.3, logs)
    files = [f"{k}<b>" for k in range(logs)]
    fitted = (np.array([0.0, 3.0, 3.0, 7.0]), np.array([1.0, 1.0, 2.0, 2.0])) if marks else None
    one = ParameterTrend(robot, "Fc", "N m", files, days, 1.0 + std * rng.standard_normal(logs), std, fitted, marks)
    return replace(one, **changes)


def test_points_intervals_line_and_mark():
    one = course()
    figure = trend_figure([one, replace(one, name="Fv<i>")], START).figure()  # plotly checks every property
    line, points = figure.data[:2]
    assert points.error_y.array == pytest.approx(1.96 * one.std, rel=1e-3)
    assert np.array(points.x[:2]) == pytest.approx(1000 * START.replace(tzinfo=UTC).timestamp() + 86.4e6 * one.days[:2])
    assert figure.layout.xaxis.type == "date"
    assert len(line.x) == 4
    assert [shape.type for shape in figure.layout.shapes] == ["line", "rect"] * 2
    assert [note.text for note in figure.layout.annotations] == ["Fc", "Fv&lt;i&gt;", "step"]
    assert points.text[0] == "0&lt;b&gt;"
    assert figure.data[0].showlegend
    assert not figure.data[2].showlegend


def test_days_are_numbers_where_there_is_no_date():
    figure = trend_figure([course(marks=())], None).figure()
    assert figure.layout.xaxis.type == "linear"
    assert figure.layout.xaxis.title.text == "day"
    assert len(figure.data) == 1


def test_logs_that_do_not_show_a_parameter_are_left_out():
    one = course()
    std = np.where(np.arange(8) == 2, np.inf, one.std)
    points = trend_figure([replace(one, std=std)], START).data[1]
    assert len(points["x"]) == 7
    nothing = replace(one, std=np.full(8, np.inf), change_line=None, marks=())
    assert len(trend_figure([nothing], START).data[0]["x"]) == 0
    assert robots_figure([nothing], START).layout["yaxis"].get("range") is None


@pytest.mark.parametrize(("draw", "most"), [(trend_figure, MAX_POINTS), (robots_figure, MAX_SMALL_POINTS)])
def test_many_logs_are_drawn_as_weighted_means(draw, most):
    one = course(5000)
    points = draw([one], START).data[1]
    assert len(points["x"]) == most
    weight = (1.96 / points["error_y"]["array"].astype(float)) ** 2
    assert weight.sum() == pytest.approx(np.sum(one.std**-2.0), rel=1e-2)
    assert np.average(points["y"], weights=weight) == pytest.approx(
        np.average(one.value, weights=one.std**-2.0), rel=1e-3
    )
    assert points["text"][0].startswith("0&lt;b&gt; to ")


def test_an_interval_that_is_far_wider_leaves_the_panel():
    one = course()
    wild = replace(
        one, value=np.where(np.arange(8) == 2, 1e3, one.value), std=np.where(np.arange(8) == 2, 1e3, one.std)
    )
    low, high = trend_figure([wild], START).layout["yaxis"]["range"]
    assert -1 < low < high < 4


def test_robots_side_by_side_have_the_same_axes():
    some = [course(robot=f"arm {k}", marks=() if k else MARKS) for k in range(10)]
    drawing = robots_figure(some, START)
    figure = drawing.figure()
    assert {figure.layout[f"yaxis{k}"].matches for k in range(2, 11)} == {"y"}
    assert {figure.layout[f"xaxis{k}"].matches for k in range(2, 11)} == {"x"}
    colours = [one["marker"]["color"] for one in drawing.data if one["mode"] == "markers"]
    assert len(set(colours)) == 2
    assert colours.count(colours[0]) == 1
    places = {tuple(figure.layout[f"{axis}axis{k or ''}"].domain[0] for axis in "xy") for k in (0, *range(2, 11))}
    assert len(places) == 10
    low, high = figure.layout.yaxis.range
    assert all(low < one.value.min() < one.value.max() < high for one in some)


def test_deviations_end_at_three_spreads():
    deviation = np.array([[0.5, -9.0], [np.pi, 0.0]])
    figure = pooled_figure(["Fv<", "Fc"], ["a", "b" * 40], deviation, [["x<", "y"], ["z", "w"]]).figure()
    assert np.array(figure.data[0].z).tolist() == [[0.5, -3.0], [3.0, 0.0]]
    assert figure.data[0].text[0][0] == "x&lt;"
    assert figure.layout.xaxis.ticktext[0] == "Fv&lt;"
    assert len(figure.layout.yaxis.ticktext[1]) == 24
