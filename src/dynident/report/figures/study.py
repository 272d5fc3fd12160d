"""Figures of the article's study: traces of the motion, and the spread of the estimates."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynident.errors import InputError, choices
from dynident.log import Motion
from dynident.report.figures.canvas import (
    AMBER,
    BLUE,
    GREEN,
    INK,
    RED,
    VIOLET,
    Array,
    Drawing,
    Trace,
    curve,
    only,
    panels,
    plain,
    trace,
)

if TYPE_CHECKING:
    from dynident.studies import Reproduction

__all__ = ["colours_of", "method_name", "scientific", "spread_figure", "trace_figure"]

MORE = ("#00909e", "#d0569b", "#7a8a00")
COLOURS = {"simulated": BLUE, "spline": RED, "filtered": INK, "raw": AMBER, "spline-early": VIOLET, "ml": GREEN}
NAMES = {
    "raw": "raw differences", "filtered": "filtered differences", "spline": "smoothing splines",
    "spline-early": "early-cut splines", "ml": "maximum likelihood",
}  # fmt: skip
DRAWN_FIRST = ("raw", "simulated", "spline", "filtered")  # later curves lie above
TITLES = {"dq": "velocity, rad/s", "ddq": "acceleration, rad/s²"}
MOST_RUNS = 153  # more estimates are drawn by as many of their quantiles; 4 k + 1 of them hold the quartiles


def method_name(method: str) -> str:
    """Word a smoothing method of the article, e.g. "raw" -> "raw differences"; other names are left as they are."""
    return NAMES.get(method, method)


def scientific(value: float) -> str:
    """Word a noise level as the article does, 1e-8 and 1e-4, without padding."""
    mantissa, exponent = f"{value:e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def trace_figure(traces: Mapping[str, Motion], joint_index: int, quantity: str) -> Drawing:
    """Draw a joint's velocity ("dq") or acceleration ("ddq") as each method sees it (article, figures 2 and 3).

    ``traces`` maps a method to its motion. Simulated is blue, spline red, filtered dashed black, the clipped part of
    filtered dashed green; "raw" waits in the legend, because its noise hides the rest. The vertical range is that of
    the samples which every method may use. Raises InputError for another quantity or joint.
    """
    if quantity not in TITLES:
        raise InputError(f"Unknown quantity {quantity!r}; {choices(quantity, TITLES)}")
    for method, motion in traces.items():
        if not 0 <= joint_index < len(motion.joints):
            raise InputError(f"{method}: no joint number {joint_index}; {choices('', motion.joints)}")
    colours = colours_of(traces)
    figure = panels([TITLES[quantity]], 380)
    order = [*DRAWN_FIRST, *sorted(set(traces) - set(DRAWN_FIRST))]
    for method in (name for name in order if name in traces):
        values = getattr(traces[method], quantity)[:, joint_index]
        for one in _curves(method, traces[method], values, colours[method]):
            figure.add(one)
    figure.axes("y", range=_common_range(traces, joint_index, quantity))
    return figure


def _curves(method: str, motion: Motion, values: Array, colour: str) -> list[Trace]:
    """Return the curve of a method, and what of the filtered one is clipped."""
    line = {"color": colour, "width": 2.5 if method == "simulated" else 1.4}
    line |= {"dash": "dash"} if method == "filtered" else {}
    name = plain(method_name(method))
    seen: Trace = {"visible": "legendonly" if method == "raw" else True}
    drawn = curve(motion.t, only(values, motion.mask), name, line) | seen
    if method != "filtered" or motion.mask.all():
        return [drawn]
    return [drawn, curve(motion.t, only(values, ~motion.mask), f"{name}, clipped", line | {"color": GREEN})]


def spread_figure(reproduction: Reproduction) -> Drawing:
    """Draw the relative error of every estimate, per parameter and method, one panel per noise level.

    The axis is asinh(error / 1 %): linear within 1 %, logarithmic beyond, so that a bias of 0.3 % and one of 100 %
    can be read in the same panel. The blue line is the true value; boxes hold the middle half of the runs.
    """
    levels = sorted({case.sigma_q2 for case in reproduction.cases})
    colours = colours_of(case.method for case in reproduction.cases)
    headings = [f"σ<sub>q</sub>² = {scientific(level)} rad²" for level in levels]
    figure = panels(["error, %"] * len(levels), 90 + 250 * len(levels), headings)
    shown: set[str] = set()
    largest = 1.0
    for case in (case for case in reproduction.cases if len(case.estimates)):
        values = _quantiles(case.estimates)
        percent = 100 * (values - reproduction.true) / np.abs(reproduction.true)
        largest = max(largest, float(np.abs(percent).max()))
        box = _box(case.method, reproduction.names, values, percent, colours[case.method])
        figure.add(box | {"showlegend": case.method not in shown}, row=levels.index(case.sigma_q2) + 1)
        shown.add(case.method)
    decades = 10.0 ** np.arange(np.ceil(np.log10(largest)) + 1)
    ticks = [*-decades[::-1], 0.0, *decades]
    words = [f"{tick:+g}" if tick else "true" for tick in ticks]
    figure.axes("y", tickvals=np.arcsinh(ticks).tolist(), ticktext=words, zeroline=True, zerolinecolor=BLUE)
    figure.axes("x", type="category", showticklabels=True, showgrid=False)
    figure.layout.update(boxmode="group", hovermode="closest")
    return figure


def _box(method: str, names: Sequence[str], values: Array, percent: Array, colour: str) -> Trace:
    return trace(
        "box",
        x=[plain(name) for name in names for _ in values],
        y=np.arcsinh(percent).T.ravel().astype(np.float32),
        customdata=np.stack([values.T.ravel(), percent.T.ravel()], axis=1).astype(np.float32),
        hovertemplate="%{x}: %{customdata[0]:.4g} (%{customdata[1]:+.2f} %)",
        name=plain(method_name(method)),
        legendgroup=method,
        offsetgroup=method,
        marker={"color": colour, "size": 2.5, "opacity": 0.6},
        line={"color": colour, "width": 1.2},
        boxpoints="all",
        pointpos=0,
        jitter=0.7,
        hoveron="points",
        meta="ink" if colour == INK else None,
    )


def colours_of(methods: Iterable[str]) -> dict[str, str]:
    """Return a colour for each method, the same ones in every figure."""
    names = list(dict.fromkeys(methods))
    others = [name for name in names if name not in COLOURS]
    return COLOURS | {name: MORE[i % len(MORE)] for i, name in enumerate(others)}


def _common_range(traces: Mapping[str, Motion], joint_index: int, quantity: str) -> list[float] | None:
    """Return the vertical range, with a margin, of the time that every method may use; None where there is none."""
    shown = [motion for method, motion in traces.items() if method != "raw" and motion.mask.any()]
    start = max((motion.t[motion.mask][0] for motion in shown), default=0.0)
    stop = min((motion.t[motion.mask][-1] for motion in shown), default=0.0)
    cuts = [motion.between(start, stop) for motion in shown]
    values = np.concatenate([np.empty(0), *(getattr(cut, quantity)[cut.mask, joint_index] for cut in cuts)])
    if not len(values):
        return None
    margin = 0.35 * np.ptp(values) or 1.0
    return [float(values.min() - margin), float(values.max() + margin)]


def _quantiles(estimates: Array) -> Array:
    """Return at most MOST_RUNS rows with the distribution of each column, extremes included."""
    if len(estimates) <= MOST_RUNS:
        return estimates
    spread: Array = np.quantile(estimates, np.linspace(0, 1, MOST_RUNS), axis=0)
    return spread
