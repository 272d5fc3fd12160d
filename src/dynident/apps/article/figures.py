"""Figures of the article's study: traces of the motion, and the spread of the estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np

from dynident.apps.article.article import Reproduction
from dynident.motion.log import Motion
from dynident.report import Array, Drawing, method_name, scientific
from dynident.report.figures import BLUE, GREEN, Trace, curve, method_colours, panels, plain, trace, with_gaps

DRAWN_FIRST = ("raw", "simulated", "spline", "filtered")  # later curves lie above
TITLES = {"dq": "velocity, rad/s", "ddq": "acceleration, rad/s²"}
METHOD_SYMBOLS = ("circle", "square", "diamond", "triangle-up", "x", "star")
MAX_RUNS = 153  # more estimates are drawn by as many of their quantiles; 4 k + 1 of them hold the quartiles


def trace_figure(traces: Mapping[str, Motion], joint_index: int, quantity: str) -> Drawing:
    """Draw a joint's velocity ("dq") or acceleration ("ddq") as each method sees it (article, figures 2 and 3).

    ``traces`` maps a method to its motion. Simulated is blue, spline red, filtered dashed black, the clipped part of
    filtered dashed green; "raw" waits in the legend, because its noise hides the rest. The vertical range is that of
    the samples which every method may use.
    """
    colours = method_colours(traces)
    figure = panels([TITLES[quantity]], 380)
    order = [*DRAWN_FIRST, *sorted(set(traces) - set(DRAWN_FIRST))]
    for method in (name for name in order if name in traces):
        values = getattr(traces[method], quantity)[:, joint_index]
        for curve_trace in _curves(method, traces[method], values, colours[method]):
            figure.add(curve_trace)
    figure.axes("y", range=_common_range(traces, joint_index, quantity))
    return figure


def _curves(method: str, motion: Motion, values: Array, colour: str) -> list[Trace]:
    """Return the curve of a method, and that of the clipped samples of the filtered one."""
    line = {"color": colour, "width": 2.5 if method == "simulated" else 1.4}
    line |= {"dash": "dash"} if method == "filtered" else {}
    name = plain(method_name(method))
    visibility: Trace = {"visible": "legendonly" if method == "raw" else True}
    main_curve = curve(motion.t, with_gaps(values, motion.mask), name, line) | visibility
    if method != "filtered" or motion.mask.all():
        return [main_curve]
    return [main_curve, curve(motion.t, with_gaps(values, ~motion.mask), f"{name}, clipped", line | {"color": GREEN})]


def spread_figure(reproduction: Reproduction) -> Drawing:
    """Draw the relative error of every estimate, per parameter and method, one panel per noise level.

    The axis is asinh(error / 1 %): linear within 1 %, logarithmic beyond, so that a bias of 0.3 % and one of 100 %
    can be read in the same panel. The blue line is the true value; boxes hold the middle half of the runs.
    """
    levels = sorted({case.sigma_q2 for case in reproduction.cases})
    colours = method_colours(case.method for case in reproduction.cases)
    headings = [f"σ<sub>q</sub>² = {scientific(level)} rad²" for level in levels]
    figure = panels(["error, %"] * len(levels), 90 + 250 * len(levels), headings)
    in_legend: set[str] = set()
    largest = 1.0
    for case in (case for case in reproduction.cases if len(case.estimates)):
        values = _quantiles(case.estimates)
        percent = 100 * (values - reproduction.true) / np.abs(reproduction.true)
        largest = max(largest, float(np.abs(percent).max()))
        box = _box(case.method, reproduction.names, values, percent, colours[case.method])
        figure.add(box | {"showlegend": case.method not in in_legend}, row=levels.index(case.sigma_q2) + 1)
        in_legend.add(case.method)
    # Ticks at powers of ten to both sides of zero, placed by asinh
    decades = 10.0 ** np.arange(np.ceil(np.log10(largest)) + 1)
    ticks = [*-decades[::-1], 0.0, *decades]
    words = [f"{tick:+g}" if tick else "true" for tick in ticks]
    figure.axes("y", tickvals=np.arcsinh(ticks).tolist(), ticktext=words, zeroline=True, zerolinecolor=BLUE)
    figure.axes("x", type="category", showticklabels=True, showgrid=False)
    figure.layout.update(boxmode="group", hovermode="closest")
    return figure


def _box(method: str, names: Sequence[str], values: Array, percent: Array, colour: str) -> Trace:
    return trace(
        "box", x=[plain(name) for name in names for _ in values], y=np.arcsinh(percent).T.ravel().astype(np.float32),
        customdata=np.stack([values.T.ravel(), percent.T.ravel()], axis=1).astype(np.float32),
        hovertemplate="%{x}: %{customdata[0]:.4g} (%{customdata[1]:+.2f} %)", name=plain(method_name(method)),
        legendgroup=method, offsetgroup=method, marker={"color": colour, "size": 2.5, "opacity": 0.6},
        line={"color": colour, "width": 1.2}, boxpoints="all", pointpos=0, jitter=0.7, hoveron="points",
    )  # fmt: skip


def _common_range(traces: Mapping[str, Motion], joint_index: int, quantity: str) -> list[float] | None:
    """Return the vertical range, with a margin, of the time that every method may use; None where there is none."""
    motions = [motion for method, motion in traces.items() if method != "raw" and motion.mask.any()]
    # The latest start and the earliest end: the time that all methods cover
    start = max((motion.t[motion.mask][0] for motion in motions), default=0.0)
    stop = min((motion.t[motion.mask][-1] for motion in motions), default=0.0)
    cuts = [motion.select_between(start, stop) for motion in motions]
    values = np.concatenate([np.empty(0), *(getattr(cut, quantity)[cut.mask, joint_index] for cut in cuts)])
    if not len(values):
        return None
    margin = 0.35 * np.ptp(values) or 1.0
    return [float(values.min() - margin), float(values.max() + margin)]


def _quantiles(estimates: Array) -> Array:
    """Return at most MAX_RUNS rows with the distribution of each column, extremes included."""
    if len(estimates) <= MAX_RUNS:
        return estimates
    spread: Array = np.quantile(estimates, np.linspace(0, 1, MAX_RUNS), axis=0)
    return spread


def efficiency_figure(reproduction: Reproduction) -> Drawing:
    """Draw the rms error of each parameter in % of its true value by method, over the bound; one panel per level."""
    levels = sorted(reproduction.bounds)
    names, true = [plain(name) for name in reproduction.names], np.abs(reproduction.true)
    headings = [f"σ<sub>q</sub>² = {scientific(level)} rad²" for level in levels]
    figure = panels(["rms error, %"] * len(levels), 90 + 260 * len(levels), headings)
    methods = list(dict.fromkeys(case.method for case in reproduction.cases))
    colours = method_colours(methods)
    cases = {(case.sigma_q2, case.method): case for case in reproduction.cases if len(case.estimates)}
    for row, level in enumerate(levels, start=1):
        bars = trace(
            "bar", x=names, y=100 * np.sqrt(reproduction.bounds[level]) / true, name="Cramér-Rao bound",
            legendgroup="bound", marker={"color": BLUE, "opacity": 0.35},
            hovertemplate="%{x}: bound %{y:.3g} %<extra></extra>",
        )  # fmt: skip
        figure.add(bars | {"showlegend": row == 1}, row=row)
        for method, symbol in zip(methods, cycle(METHOD_SYMBOLS)):
            if case := cases.get((level, method)):
                error = 100 * np.sqrt(np.mean((case.estimates - reproduction.true) ** 2, axis=0)) / true
                marks = trace(
                    "scatter", x=names, y=error, mode="markers", name=plain(method_name(method)), legendgroup=method,
                    marker={"color": colours[method], "size": 9, "symbol": symbol}, hovertemplate="%{x}: %{y:.3g} %",
                )  # fmt: skip
                figure.add(marks | {"showlegend": row == 1}, row=row)
    figure.axes("y", type="log", dtick=1, exponentformat="power")
    figure.axes("x", type="category", showticklabels=True, showgrid=False)
    figure.layout.update(hovermode="closest")
    return figure
