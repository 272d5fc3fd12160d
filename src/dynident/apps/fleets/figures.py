"""Figures of a fleet: parameters of a robot from log to log, those of all robots side by side, and what they share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.motion.splines import NORMAL_95
from dynident.report import Array, Drawing
from dynident.report.figures import AMBER, BLUE, RED, TEMPLATE, Trace, panels, plain, trace
from dynident.runtime import Noun

MAX_POINTS, MAX_SMALL_POINTS = 300, 60  # of one panel: of a robot alone, and of many side by side
COLUMNS, SMALL_HEIGHT = 4, 130  # panels beside each other, and their height
DAY = 86_400_000.0  # ms
MAX_STD_RATIO = 5.0  # median standard errors of a course, beyond which a log's interval may leave its panel
MAX_SPREADS = 3.0  # spreads of the robots at which the colours of a deviation end


@dataclass(frozen=True, eq=False)
class Mark:
    """Where a change begins: its ``day``, the first and the last day it may be ``between``, and the ``word`` for it."""

    day: float
    word: str
    between: tuple[float, float]


class ParameterTrend(Noun):
    """One parameter of one robot from log to log: ``value`` with standard error ``std``, both (K), at ``days`` (K).

    ``std`` is not finite where a log does not show the parameter; ``change_line``, days and values, is the
    line of the changes found, which begin at the ``marks``.
    """

    robot: str
    name: str
    unit: str
    logs: Sequence[str]
    days: Array
    value: Array
    std: Array
    change_line: tuple[Array, Array] | None = None
    marks: Sequence[Mark] = ()


def trend_figure(trends: Sequence[ParameterTrend], start: datetime | None = None) -> Drawing:
    """Draw parameters of one robot over time, one panel each, with 95 % intervals and a line where a change begins.

    ``start`` is the date of day 0, None where there is none. Of more than ``MAX_POINTS`` logs as many are
    drawn, spread evenly.
    """
    units, names = ([plain(getattr(trend, field)) for trend in trends] for field in ("unit", "name"))
    figure = panels(units, 100 + 200 * len(trends), names)
    _time_axis(figure, start)
    for row, trend in enumerate(trends, start=1):
        for curve in _trend_traces(trend, start, MAX_POINTS):
            figure.add(curve | {"showlegend": row == 1}, row=row)
        figure.layout[f"yaxis{row if row > 1 else ''}"]["range"] = _value_range([trend])
    shapes = [shape for row, trend in enumerate(trends, start=1) for shape in _change_shapes(trend, start, row)]
    words = [_mark_label(mark, start) for mark in (trends[0].marks if trends else ())]
    for heading in figure.layout["annotations"]:
        heading.update(x=0.0, xanchor="left", font={"size": 14})
    figure.layout["annotations"] += words
    figure.layout.update(hovermode="closest", shapes=shapes, showlegend=True)
    return figure


def robots_figure(trends: Sequence[ParameterTrend], start: datetime | None = None) -> Drawing:
    """Draw one parameter of many robots, a small panel each, all with the same axes; marked robots in red."""
    figure = _panel_grid([trend.robot for trend in trends])
    for k, trend in enumerate(trends, start=1):
        for curve in _trend_traces(trend, start, MAX_SMALL_POINTS, RED if trend.marks else BLUE, size=4):
            figure.add(curve | {"showlegend": False}, row=k)
    _time_axis(figure, start, title="")
    figure.axes("y", range=_value_range(trends))
    shapes = [shape for k, trend in enumerate(trends, start=1) for shape in _change_shapes(trend, start, k)]
    figure.layout.update(shapes=shapes, hovermode="closest")
    return figure


def pooled_figure(
    names: Sequence[str], robots: Sequence[str], deviation: Array, words: Sequence[Sequence[str]]
) -> Drawing:
    """Draw how far each robot (R) is from the mean of its type in each parameter (b), in spreads of the robots.

    ``deviation`` is (R, b), ``words`` the text of each field; blue is below the mean, red above.
    """
    rows, columns = list(range(len(robots))), list(range(len(names)))
    figure = panels([""], 150 + 22 * len(robots), shared=False)
    heat = trace(
        "heatmap",
        x=columns,
        y=rows,
        z=[[float(x) for x in row] for row in np.clip(deviation, -MAX_SPREADS, MAX_SPREADS)],
        text=[[plain(text) for text in row] for row in words],
        zmin=-MAX_SPREADS,
        zmax=MAX_SPREADS,
        xgap=1,
        ygap=1,
        colorscale=[[0.0, BLUE], [0.5, "rgba(128, 128, 128, 0.08)"], [1.0, RED]],
        colorbar={"title": {"text": "spreads"}, "thickness": 12, "outlinewidth": 0},
        hovertemplate="%{text}<extra></extra>",
    )
    figure.add(heat)
    figure.axes("x", tickvals=columns, ticktext=[_short_label(name) for name in names], tickangle=-60, showgrid=False)
    figure.axes("y", tickvals=rows, ticktext=[_short_label(robot) for robot in robots], showgrid=False)
    figure.axes("y", range=[len(robots) - 0.5, -0.5])
    figure.axes("x", tickfont={"size": 10})
    figure.layout["hovermode"] = "closest"
    return figure


def _trend_traces(
    trend: ParameterTrend, start: datetime | None, max_points: int, colour: str = BLUE, size: int = 6
) -> list[Trace]:
    """Return the marks of a trend with their intervals, and the line of the changes found."""
    shown = _shown_logs(trend, max_points)
    marks = trace(
        "scatter",
        x=_axis_positions(trend.days[shown], start),
        y=trend.value[shown].astype(np.float32),
        error_y={
            "array": (NORMAL_95 * trend.std[shown]).astype(np.float32),
            "color": colour,
            "thickness": 1,
            "width": 0,
        },
        mode="markers",
        name="log, with its 95 % interval",
        marker={"color": colour, "size": size},
        text=[plain(trend.logs[k]) for k in shown],
        hovertemplate="%{text}: %{y:.4g}<extra></extra>",
    )
    if trend.change_line is None:
        return [marks]
    line = trace(
        "scatter",
        x=_axis_positions(trend.change_line[0], start),
        y=trend.change_line[1].astype(np.float32),
        mode="lines",
        name="the changes found",
        line={"color": AMBER, "width": 2},
        hoverinfo="skip",
    )
    return [line, marks]


def _shown_logs(trend: ParameterTrend, max_points: int) -> NDArray[np.intp]:
    """Return the logs that show the parameter, at most ``max_points`` of them, spread evenly."""
    visible = np.flatnonzero(np.isfinite(trend.std) & np.isfinite(trend.value))
    if len(visible) <= max_points:
        return visible
    return np.asarray(visible[np.linspace(0, len(visible) - 1, max_points).round().astype(int)])


def _axis_positions(days: Array, start: datetime | None) -> Array:
    """Return where days stand on the axis: at themselves, or, with dates, in ms since 1970."""
    return days if start is None else 1000 * start.replace(tzinfo=start.tzinfo or UTC).timestamp() + DAY * days


def _time_axis(figure: Drawing, start: datetime | None, title: str | None = None) -> None:
    name = "" if start is not None else "day"
    for key in [key for key in figure.layout if key.startswith("xaxis")]:
        figure.layout[key].pop("title", None)
    figure.axes("x", type="date" if start is not None else "linear")
    last = [key for key in figure.layout if key.startswith("xaxis")][-1]
    figure.layout[last]["title"] = {"text": name if title is None else title}


def _change_shapes(trend: ParameterTrend, start: datetime | None, row: int) -> Iterator[dict[str, Any]]:
    """Yield a line where each change begins, and a pale strip where it may have begun."""
    number = row if row > 1 else ""
    for mark in trend.marks:
        day, earliest, latest = _axis_positions(np.array([mark.day, *mark.between]), start).tolist()
        place = {"xref": f"x{number}", "yref": f"y{number} domain", "y0": 0, "y1": 1}
        yield {"type": "line", **place, "x0": day, "x1": day, "line": {"color": AMBER, "width": 1.5, "dash": "dash"}}
        strip = {"fillcolor": AMBER, "opacity": 0.15, "line": {"width": 0}, "layer": "below"}
        yield {"type": "rect", **place, "x0": earliest, "x1": latest, **strip}


def _mark_label(mark: Mark, start: datetime | None) -> dict[str, Any]:
    place = {"xref": "x", "yref": "y domain", "x": _axis_positions(np.array([mark.day]), start)[0], "y": 1.0}
    sides = {"xanchor": "left", "xshift": 4, "yanchor": "top"}
    return {**place, **sides, "text": plain(mark.word), "showarrow": False, "font": {"size": 12}}


def _value_range(trends: Sequence[ParameterTrend]) -> list[float] | None:
    """Return the range of the well determined values and of the lines; much wider intervals leave the panel."""
    ends = [np.empty(0)]
    for trend in trends:
        finite = np.isfinite(trend.std) & np.isfinite(trend.value)
        # An interval far wider than the median would squeeze all others
        reliable = finite & (trend.std <= MAX_STD_RATIO * np.median(trend.std[finite])) if finite.any() else finite
        value, half = trend.value[reliable], NORMAL_95 * trend.std[reliable]
        ends += [value - half, value + half, *((trend.change_line[1],) if trend.change_line else ())]
    shown_values = np.concatenate(ends)
    if not shown_values.size:
        return None
    low, high = float(shown_values.min()), float(shown_values.max())
    pad = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return [low - pad, high + pad]


def _panel_grid(titles: Sequence[str]) -> Drawing:
    """Return small panels in a grid, each with its title; all zoom together."""
    lines = max(-(-len(titles) // COLUMNS), 1)
    height = 60 + (SMALL_HEIGHT + 30) * lines
    layout: dict[str, Any] = {"template": TEMPLATE, "height": height, "margin": {"t": 24, "b": 36}, "annotations": []}
    high, wide = SMALL_HEIGHT / (height - 60), (1 - 0.03 * (COLUMNS - 1)) / COLUMNS
    for k, title in enumerate(titles):
        row, column = divmod(k, COLUMNS)
        name, left, top = k + 1 if k else "", column * (wide + 0.03), 1 - row / lines
        outer = k + COLUMNS >= len(titles)
        x = {"anchor": f"y{name}", "domain": [left, left + wide], "showticklabels": outer, "nticks": 3}
        y = {"anchor": f"x{name}", "domain": [max(top - high, 0.0), top], "showticklabels": column == 0, "nticks": 4}
        layout[f"xaxis{name}"] = x | ({"matches": "x"} if k else {})
        layout[f"yaxis{name}"] = y | ({"matches": "y"} if k else {})
        place = {"x": left, "xref": "paper", "xanchor": "left", "y": top, "yref": "paper", "yanchor": "bottom"}
        layout["annotations"].append({"text": _short_label(title), "showarrow": False, "font": {"size": 11}, **place})
    return Drawing([], layout)


def _short_label(name: str) -> str:
    return plain(name if len(name) <= 24 else f"{name[:12]}…{name[-11:]}")
