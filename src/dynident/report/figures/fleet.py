"""Figures of a fleet: parameters of a robot from log to log, those of all robots side by side, and what they share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from dynident.errors import brief
from dynident.report.figures.canvas import (
    AMBER,
    BLUE,
    RED,
    TEMPLATE,
    Array,
    Drawing,
    Trace,
    panels,
    plain,
    trace,
)
from dynident.splines import NORMAL_95

__all__ = ["MOST_POINTS", "SMALL_POINTS", "Course", "Mark", "course_figure", "pooled_figure", "robots_figure"]

MOST_POINTS, SMALL_POINTS = 300, 60  # of one panel: of a robot alone, and of many side by side
COLUMNS, SMALL = 4, 130  # panels beside each other, and their height
DAY = 86_400_000.0  # ms
WIDE = 5.0  # median standard errors of a course, beyond which a log's interval may leave its panel
FAR = 3.0  # spreads of the robots at which the colours of a deviation end


@dataclass(frozen=True, eq=False)
class Mark:
    """Where a change begins: ``day``, the first and the last that it may be, and the ``word`` for it."""

    day: float
    word: str
    between: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Course:
    """One parameter of one robot from log to log: ``value`` with its standard error ``std``, both (K), at ``days`` (K).

    ``std`` is not finite where a log does not show the parameter; ``fitted``, days and values, is the line of the
    changes found, which begin at the ``marks``.
    """

    robot: str
    name: str
    unit: str
    logs: Sequence[str]
    days: Array
    value: Array
    std: Array
    fitted: tuple[Array, Array] | None = None
    marks: Sequence[Mark] = ()

    __repr__ = brief


def course_figure(courses: Sequence[Course], start: datetime | None = None) -> Drawing:
    """Draw parameters of one robot over time, one panel each, with 95 % intervals and a line where a change begins.

    ``start`` is the date of day 0, None where there is none. Neighbouring logs are drawn as their
    weighted mean where there are more than ``MOST_POINTS``.
    """
    figure = panels(
        [plain(one.unit) for one in courses], 100 + 200 * len(courses), [plain(one.name) for one in courses]
    )
    _time_axis(figure, start)
    for row, one in enumerate(courses, start=1):
        for curve in _course(one, start, MOST_POINTS):
            figure.add(curve | {"showlegend": row == 1}, row=row)
        figure.layout[f"yaxis{row if row > 1 else ''}"]["range"] = _range([one])
    shapes = [shape for row, one in enumerate(courses, start=1) for shape in _shapes(one, start, row)]
    words = [_word(mark, start) for mark in (courses[0].marks if courses else ())]
    for heading in figure.layout["annotations"]:
        heading.update(x=0.0, xanchor="left", font={"size": 14})
    figure.layout["annotations"] += words
    figure.layout.update(hovermode="closest", shapes=shapes, showlegend=True)
    return figure


def robots_figure(courses: Sequence[Course], start: datetime | None = None) -> Drawing:
    """Draw one parameter of many robots, a small panel each, all with the same axes; marked robots in red."""
    figure = _grid([one.robot for one in courses])
    for k, one in enumerate(courses, start=1):
        for curve in _course(one, start, SMALL_POINTS, RED if one.marks else BLUE, size=4):
            figure.add(curve | {"showlegend": False}, row=k)
    _time_axis(figure, start, title="")
    figure.axes("y", range=_range(courses))
    figure.layout["shapes"] = [shape for k, one in enumerate(courses, start=1) for shape in _shapes(one, start, k)]
    figure.layout["hovermode"] = "closest"
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
        z=[[float(x) for x in row] for row in np.clip(deviation, -FAR, FAR)],
        text=[[plain(text) for text in row] for row in words],
        zmin=-FAR,
        zmax=FAR,
        xgap=1,
        ygap=1,
        colorscale=[[0.0, BLUE], [0.5, "rgba(128, 128, 128, 0.08)"], [1.0, RED]],
        colorbar={"title": {"text": "spreads"}, "thickness": 12, "outlinewidth": 0},
        hovertemplate="%{text}<extra></extra>",
    )
    figure.add(heat)
    figure.axes("x", tickvals=columns, ticktext=[_short(name) for name in names], tickangle=-60, showgrid=False)
    figure.axes("y", tickvals=rows, ticktext=[_short(robot) for robot in robots], showgrid=False)
    figure.axes("y", range=[len(robots) - 0.5, -0.5])
    figure.axes("x", tickfont={"size": 10})
    figure.layout["hovermode"] = "closest"
    return figure


def _course(one: Course, start: datetime | None, most: int, colour: str = BLUE, size: int = 6) -> list[Trace]:
    """Return the marks of a course with their intervals, and the line of what was found."""
    names, days, value, std = _merged(one, most)
    marks = trace(
        "scatter",
        x=_at(days, start),
        y=value.astype(np.float32),
        error_y={"array": (NORMAL_95 * std).astype(np.float32), "color": colour, "thickness": 1, "width": 0},
        mode="markers",
        name="log, with its 95 % interval",
        marker={"color": colour, "size": size},
        text=names,
        hovertemplate="%{text}: %{y:.4g}<extra></extra>",
    )
    if one.fitted is None:
        return [marks]
    line = trace(
        "scatter",
        x=_at(one.fitted[0], start),
        y=one.fitted[1].astype(np.float32),
        mode="lines",
        name="the changes found",
        line={"color": AMBER, "width": 2},
        hoverinfo="skip",
    )
    return [line, marks]


def _merged(one: Course, most: int) -> tuple[list[str], Array, Array, Array]:
    """Return names, days, values and standard errors of at most ``most`` points: neighbouring logs by their weights."""
    seen = np.flatnonzero(np.isfinite(one.std) & np.isfinite(one.value))
    if len(seen) <= most:
        return [plain(one.logs[int(k)]) for k in seen], one.days[seen], one.value[seen], one.std[seen]
    parts = np.array_split(seen, most)
    weights = [1 / np.maximum(one.std[part], 1e-12 * one.std[seen].max()) ** 2 for part in parts]
    means = [
        [np.average(values[part], weights=weight) for part, weight in zip(parts, weights, strict=True)]
        for values in (one.days, one.value)
    ]
    names = [" to ".join(plain(one.logs[int(k)]) for k in part[[0, -1]]) for part in parts]
    return names, np.array(means[0]), np.array(means[1]), np.array([weight.sum() ** -0.5 for weight in weights])


def _at(days: Array, start: datetime | None) -> Array:
    """Return the places of days at the axis: of dates, ms since 1970."""
    return days if start is None else 1000 * start.replace(tzinfo=start.tzinfo or UTC).timestamp() + DAY * days


def _time_axis(figure: Drawing, start: datetime | None, title: str | None = None) -> None:
    name = "" if start is not None else "day"
    for key in [key for key in figure.layout if key.startswith("xaxis")]:
        figure.layout[key].pop("title", None)
    figure.axes("x", type="date" if start is not None else "linear")
    last = [key for key in figure.layout if key.startswith("xaxis")][-1]
    figure.layout[last]["title"] = {"text": name if title is None else title}


def _shapes(course: Course, start: datetime | None, row: int) -> Iterator[dict[str, Any]]:
    """Yield a line where each change begins, and a pale strip where it may."""
    number = row if row > 1 else ""
    for mark in course.marks:
        day, first, last = _at(np.array([mark.day, *mark.between]), start).tolist()
        place = {"xref": f"x{number}", "yref": f"y{number} domain", "y0": 0, "y1": 1}
        yield {"type": "line", **place, "x0": day, "x1": day, "line": {"color": AMBER, "width": 1.5, "dash": "dash"}}
        strip = {"fillcolor": AMBER, "opacity": 0.15, "line": {"width": 0}, "layer": "below"}
        yield {"type": "rect", **place, "x0": first, "x1": last, **strip}


def _word(mark: Mark, start: datetime | None) -> dict[str, Any]:
    place = {"xref": "x", "yref": "y domain", "x": _at(np.array([mark.day]), start)[0], "y": 1.0}
    sides = {"xanchor": "left", "xshift": 4, "yanchor": "top"}
    return {**place, **sides, "text": plain(mark.word), "showarrow": False, "font": {"size": 12}}


def _range(courses: Sequence[Course]) -> list[float] | None:
    """Return the range of what the logs show well and of the lines; intervals that are far wider leave the panel."""
    ends = [np.empty(0)]
    for one in courses:
        known = np.isfinite(one.std) & np.isfinite(one.value)
        sure = known & (one.std <= WIDE * np.median(one.std[known])) if known.any() else known
        ends += [one.value[sure] - NORMAL_95 * one.std[sure], one.value[sure] + NORMAL_95 * one.std[sure]]
        ends += [one.fitted[1]] if one.fitted else []
    every = np.concatenate(ends)
    if not every.size:
        return None
    low, high = float(every.min()), float(every.max())
    pad = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return [low - pad, high + pad]


def _grid(titles: Sequence[str]) -> Drawing:
    """Return small panels beside and below each other, each with its title, the axes of all zooming together."""
    lines = max(-(-len(titles) // COLUMNS), 1)
    height = 60 + (SMALL + 30) * lines
    layout: dict[str, Any] = {"template": TEMPLATE, "height": height, "margin": {"t": 24, "b": 36}, "annotations": []}
    high, wide = SMALL / (height - 60), (1 - 0.03 * (COLUMNS - 1)) / COLUMNS
    for k, title in enumerate(titles):
        row, column = divmod(k, COLUMNS)
        name, left, top = k + 1 if k else "", column * (wide + 0.03), 1 - row / lines
        outer = k + COLUMNS >= len(titles)
        x = {"anchor": f"y{name}", "domain": [left, left + wide], "showticklabels": outer, "nticks": 3}
        y = {"anchor": f"x{name}", "domain": [max(top - high, 0.0), top], "showticklabels": column == 0, "nticks": 4}
        layout[f"xaxis{name}"] = x | ({"matches": "x"} if k else {})
        layout[f"yaxis{name}"] = y | ({"matches": "y"} if k else {})
        place = {"x": left, "xref": "paper", "xanchor": "left", "y": top, "yref": "paper", "yanchor": "bottom"}
        layout["annotations"].append({"text": _short(title), "showarrow": False, "font": {"size": 11}, **place})
    return Drawing([], layout)


def _short(name: str) -> str:
    return plain(name if len(name) <= 24 else f"{name[:12]}…{name[-11:]}")
