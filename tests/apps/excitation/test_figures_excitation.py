"""Figures of a designed motion."""

import numpy as np

from dynident.apps.excitation import LimitedQuantity, design_figure, distance_figure, expected_figure

T = np.linspace(0, 2, 50)


def test_limits_are_in_sight_and_missing_ones_are_not() -> None:
    one, other = (
        LimitedQuantity("velocity, rad/s", np.sin(T), -2.0, 2.0),
        LimitedQuantity("torque, N m", np.cos(T), -np.inf, np.inf),
    )
    figure = design_figure(T, [one, other])
    assert [trace["name"] for trace in figure.data] == ["velocity", "limit", "limit", "torque"]
    low, high = figure.layout["yaxis"]["range"]
    assert low < -2 < 2 < high
    assert figure.layout["yaxis2"]["range"][1] < 1.2


def test_distances_with_the_clearance() -> None:
    figure = distance_figure(T, T + 0.1, 0.05)
    assert list(figure.data[1]["y"]) == [0.05, 0.05]


def test_what_is_not_known_before_is_left_out() -> None:
    before = np.array([np.inf, 3.0])
    figure = expected_figure(["<m>", "b"], np.array([1.0, 2.0]), 10.0, before)
    *_, now, then = figure.data
    assert now["text"] == ["&lt;m&gt;", "b"]
    assert list(then["x"]) == [3.0]
    assert figure.layout["showlegend"]
