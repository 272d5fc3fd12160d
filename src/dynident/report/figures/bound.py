"""Figures of the Cramer-Rao bound: what a record can say of each parameter, and what methods make of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from dynident.report.figures.canvas import (
    AMBER,
    BLUE,
    GREEN,
    INK,
    RED,
    Array,
    Drawing,
    Trace,
    mark_rows,
    panels,
    plain,
    trace,
)
from dynident.report.figures.study import colours_of, method_name, scientific

if TYPE_CHECKING:
    from dynident.bounds import AccuracyBound
    from dynident.studies import Reproduction

__all__ = ["CHANGE_NAMES", "bound_figure", "efficiency_figure"]

CHANGE_NAMES: Mapping[str, str] = {
    "now": "now",
    "bit": "+1 encoder bit",
    "torque": "torque × 10",
    "twice": "2 × record",
    "longer": "4 × record",
}
LOOKS = {
    "now": (RED, "circle"), "bit": (BLUE, "circle-open"),
    "torque": (GREEN, "diamond"), "longer": (AMBER, "line-ns-open"),
}  # fmt: skip
MARKS = ("circle", "square", "diamond", "triangle-up", "x", "star")


def bound_figure(found: AccuracyBound, labels: Sequence[str]) -> Drawing:
    """Draw the least standard deviation of each parameter in % of its value, now and after each change; log axis."""
    labels = [plain(label) for label in labels]
    figure = panels([""], 130 + 20 * len(labels), shared=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        fit = 100 * found.fit / np.abs(found.value)
        series = {name: 100 * std / np.abs(found.value) for name, std in found.std.items() if name in LOOKS}
    shown = {"fit": (fit, "this fit", INK, "x-thin-open"), **{
        name: (values, CHANGE_NAMES[name], *LOOKS[name]) for name, values in series.items()
    }}  # fmt: skip
    mark_rows(figure, labels, shown.values(), "standard deviation, % of the value")
    return figure


def efficiency_figure(reproduction: Reproduction) -> Drawing:
    """Draw the rms error of each parameter in % of its true value by method, over the bound; one panel per level."""
    levels = sorted(reproduction.bounds)
    names, true = [plain(name) for name in reproduction.names], np.abs(reproduction.true)
    headings = [f"σ<sub>q</sub>² = {scientific(level)} rad²" for level in levels]
    figure = panels(["rms error, %"] * len(levels), 90 + 260 * len(levels), headings)
    methods = list(dict.fromkeys(case.method for case in reproduction.cases))
    colours = colours_of(methods)
    cases = {(case.sigma_q2, case.method): case for case in reproduction.cases if len(case.estimates)}
    for row, level in enumerate(levels, start=1):
        least = _least(names, 100 * np.sqrt(reproduction.bounds[level]) / true)
        figure.add(least | {"showlegend": row == 1}, row=row)
        for method, symbol in zip(methods, cycle(MARKS)):
            if case := cases.get((level, method)):
                error = 100 * np.sqrt(np.mean((case.estimates - reproduction.true) ** 2, axis=0)) / true
                reached = _reached(names, error, method, colours[method], symbol)
                figure.add(reached | {"showlegend": row == 1}, row=row)
    figure.axes("y", type="log", dtick=1, exponentformat="power")
    figure.axes("x", type="category", showticklabels=True, showgrid=False)
    figure.layout.update(hovermode="closest")
    return figure


def _least(names: list[str], percent: Array) -> Trace:
    return trace(
        "bar",
        x=names,
        y=percent,
        name="Cramér-Rao bound",
        legendgroup="bound",
        marker={"color": BLUE, "opacity": 0.35},
        hovertemplate="%{x}: bound %{y:.3g} %<extra></extra>",
    )


def _reached(names: list[str], percent: Array, method: str, colour: str, symbol: str) -> Trace:
    return trace(
        "scatter",
        x=names,
        y=percent,
        mode="markers",
        name=plain(method_name(method)),
        legendgroup=method,
        marker={"color": colour, "size": 9, "symbol": symbol},
        hovertemplate="%{x}: %{y:.3g} %",
        meta="ink" if colour == INK else None,
    )
