"""The figures of a comparison."""

from __future__ import annotations

from dynident.apps.ranking import cost_figure, ranking_figure
from tests.report.rankings import ranking, untold


def test_each_combination_has_its_line_and_mark() -> None:
    found = ranking(6, 10)
    figure = ranking_figure(found)
    marks = [one for one in figure.data if one["mode"] == "markers"]
    assert [one["name"] for one in marks] == [f"smoother{k}" for k in range(6)]
    heights = [y for one in marks for y in one["y"]]
    assert len(set(heights)) == len(heights) == 59
    assert figure.layout["yaxis"]["ticktext"] == [f"estimator{k}" for k in range(10)]
    assert marks[0]["marker"]["symbol"][:2] == ["circle", "circle-open"]
    assert figure.layout["height"] < 1300
    assert figure.layout["xaxis"]["type"] == "log"
    assert figure.figure()
    assert cost_figure(found).figure()


def test_without_chance_there_are_no_whiskers() -> None:
    figure = ranking_figure(untold(ranking()))
    assert not any("error_x" in one for one in figure.data)
    assert "type" not in figure.layout["xaxis"]
