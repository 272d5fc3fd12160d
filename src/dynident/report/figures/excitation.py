"""Figures of a designed motion: it and its limits over time, distances, and what it is expected to tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.errors import brief
from dynident.report.figures.canvas import (
    AMBER,
    BLUE,
    GREEN,
    PALE,
    RED,
    Array,
    Drawing,
    Trace,
    curve,
    mark_rows,
    panels,
    plain,
    trace,
)

__all__ = ["Quantity", "designed_figure", "distance_figure", "expected_figure"]

ROOM = 0.08  # share of a range above and below it


@dataclass(frozen=True, eq=False)
class Quantity:
    """One quantity of a joint over time (N), with its limits, infinite where there is none."""

    title: str
    values: Array
    lower: float
    upper: float

    __repr__ = brief


def designed_figure(t: Array, quantities: Sequence[Quantity], points: int = 2000) -> Drawing:
    """Draw quantities of a joint over time t (N), one panel each, between their limits."""
    figure = panels([one.title for one in quantities], 60 + 150 * len(quantities))
    for row, one in enumerate(quantities, start=1):
        line = {"color": BLUE, "width": 1.4}
        figure.add(curve(t, one.values, one.title.partition(",")[0], line, points), row=row)
        for limit in (one.lower, one.upper):
            if np.isfinite(limit):
                figure.add(_level(t, limit, RED, "limit"), row=row)
        ends = [x for x in (one.lower, one.upper, *_ends(one.values)) if np.isfinite(x)]
        room = ROOM * (max(ends) - min(ends) or 1.0)
        axis = figure.layout[f"yaxis{row}" if row > 1 else "yaxis"]
        axis["range"] = [min(ends) - room, max(ends) + room]
    figure.layout.update(showlegend=False, margin={"t": 15})
    return figure


def _ends(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _level(t: Array, value: float, colour: str, name: str) -> Trace:
    """Return a horizontal line."""
    return trace(
        "scatter",
        x=[float(t[0]), float(t[-1])],
        y=[value, value],
        mode="lines",
        name=name,
        line={"color": colour, "width": 1.2, "dash": "dash"},
        hoverinfo="skip",
    )


def distance_figure(t: Array, distance: Array, clearance: float, points: int = 2000) -> Drawing:
    """Draw the smallest distance (N) of all pairs over time t (N), and the clearance that is kept."""
    figure = panels(["distance, m"], 260)
    figure.add(curve(t, distance, "smallest distance", {"color": BLUE, "width": 1.4}, points))
    figure.add(_level(t, clearance, RED, "clearance"))
    figure.axes("y", rangemode="tozero")
    figure.layout.update(showlegend=False, margin={"t": 15})
    return figure


def expected_figure(labels: Sequence[str], percent: Array, mark: float, before: Array | None = None) -> Drawing:
    """Draw the expected standard error of each parameter in % of its value, on a logarithmic axis with a line at a
    ``mark``, and that known ``before``; what is infinite is left out."""
    labels = [plain(label) for label in labels]
    figure = panels([""], 120 + 20 * len(labels), shared=False)
    figure.add(
        trace(
            "scatter",
            x=[mark, mark],
            y=[-0.5, len(labels) - 0.5],
            mode="lines",
            line={"color": PALE, "width": 1.0, "dash": "dot"},
            hoverinfo="skip",
            showlegend=False,
        )
    )
    series = [(percent, "with this motion", GREEN, "circle")]
    series += [] if before is None else [(before, "known before", AMBER, "circle-open")]
    mark_rows(figure, labels, series, "expected standard error, % of the value")
    figure.layout.update(showlegend=before is not None)
    return figure
