"""Figures of a study and of an identification: nouns in, plotly figures out; no file is opened or written.

Backgrounds are transparent and fonts inherited. Lines with ``meta`` "ink" and all text are drawn in a grey that is
readable on white and on black; a page may repaint them in its own text colour.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, choices
from dynident.log import Motion

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from dynident.article import Reproduction
    from dynident.identify import Identification
    from dynident.validation import LogValidation

__all__ = [
    "method_name",
    "motion_figure",
    "parameter_figure",
    "scientific",
    "spread_figure",
    "thin",
    "torque_figure",
    "trace_figure",
]

Array = NDArray[np.float64]

INK = "#7d7d7d"
BLUE, RED, GREEN, AMBER = "#3584e4", "#e5484d", "#2e9e5b", "#c98500"
GRID = "rgba(128, 128, 128, 0.25)"
MORE = ("#8f5bd6", "#00909e", "#d0569b", "#7a8a00")
COLOURS = {"simulated": BLUE, "spline": RED, "filtered": INK, "raw": AMBER}
NAMES = {"raw": "raw differences", "filtered": "filtered differences", "spline": "smoothing splines"}
DRAWN_FIRST = ("raw", "simulated", "spline", "filtered")  # later curves lie above
NORMAL_95 = 1.96  # two-sided 95 % quantile of the normal distribution
MOST_RUNS = 153  # more estimates are drawn by as many of their quantiles; 4 k + 1 of them hold the quartiles


def method_name(method: str) -> str:
    """Word a smoothing method of the article, e.g. "raw" -> "raw differences"; other names are left as they are."""
    return NAMES.get(method, method)


def scientific(value: float) -> str:
    """Word a noise level as the article does, 1e-8 and 1e-4, without padding."""
    mantissa, exponent = f"{value:e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def thin(t: Array, y: Array, points: int = 2000) -> tuple[Array, Array]:
    """Thin the curve y(t), both (N), to about ``points`` samples such that no extreme is lost.

    The first and last sample and the least and greatest of each bucket of neighbours stay, so that the curve looks
    the same where a bucket is no wider than a pixel. NaN marks a gap; a gap wider than a bucket stays a gap.
    Raises InputError for fewer than 8 points.
    """
    if points < 8:
        raise InputError(f"A curve cannot be thinned to {points} points; ask for at least 8.")
    if len(t) <= points:
        return t, y
    gaps = np.isnan(y).any()
    width = -(-len(t) // ((points - 2) // (3 if gaps else 2)))
    rows = np.full((-(-len(t) // width), width), np.nan)
    rows.flat[: len(t)] = y
    hole = np.isnan(rows)
    picks = [np.where(hole, np.inf, rows).argmin(axis=1), np.where(hole, -np.inf, rows).argmax(axis=1)]
    if gaps:
        picks.append(hole.argmax(axis=1))
    starts = width * np.arange(len(rows))
    index = np.unique(np.concatenate([[0, len(t) - 1], *(starts + pick for pick in picks)]))
    index = index[index < len(t)]  # the last bucket may not be full
    return t[index], y[index]


def trace_figure(traces: Mapping[str, Motion], joint_index: int, quantity: str) -> go.Figure:
    """Draw a joint's velocity ("dq") or acceleration ("ddq") as each method sees it (article, figures 2 and 3).

    ``traces`` maps a method to its motion. Simulated is blue, spline red, filtered dashed black, the clipped part of
    filtered dashed green; "raw" waits in the legend, because its noise hides the rest. The vertical range is that of
    the samples which every method may use. Raises InputError for another quantity or joint.
    """
    titles = {"dq": "velocity, rad/s", "ddq": "acceleration, rad/s²"}
    if quantity not in titles:
        raise InputError(f"Unknown quantity {quantity!r}; {choices(quantity, titles)}")
    for method, motion in traces.items():
        if not 0 <= joint_index < len(motion.joints):
            raise InputError(f"{method}: no joint number {joint_index}; {choices('', motion.joints)}")
    colours = _colours(traces)
    figure = _panels([titles[quantity]], 380)
    order = [*DRAWN_FIRST, *sorted(set(traces) - set(DRAWN_FIRST))]
    for method in (name for name in order if name in traces):
        motion = traces[method]
        values = getattr(motion, quantity)[:, joint_index]
        line = {"color": colours[method], "width": 2.5 if method == "simulated" else 1.4}
        line |= {"dash": "dash"} if method == "filtered" else {}
        name = _plain(method_name(method))
        curve = _curve(motion.t, _only(values, motion.mask), name, line)
        figure.add_trace(curve.update(visible="legendonly" if method == "raw" else True))
        if method == "filtered" and not motion.mask.all():
            figure.add_trace(_curve(motion.t, _only(values, ~motion.mask), f"{name}, clipped", line | {"color": GREEN}))
    figure.update_yaxes(range=_common_range(traces, joint_index, quantity))
    return figure


def spread_figure(reproduction: Reproduction) -> go.Figure:
    """Draw the relative error of every estimate, per parameter and method, one panel per noise level.

    The axis is asinh(error / 1 %): linear within 1 %, logarithmic beyond, so that a bias of 0.3 % and one of 100 %
    can be read in the same panel. The blue line is the true value; boxes hold the middle half of the runs.
    """
    levels = sorted({case.sigma_q2 for case in reproduction.cases})
    colours = _colours(case.method for case in reproduction.cases)
    headings = [f"σ<sub>q</sub>² = {scientific(level)} rad²" for level in levels]
    figure = _panels(["error, %"] * len(levels), 90 + 250 * len(levels), headings)
    shown: set[str] = set()
    largest = 1.0
    for case in (case for case in reproduction.cases if len(case.estimates)):
        values = _quantiles(case.estimates)
        percent = 100 * (values - reproduction.true) / np.abs(reproduction.true)
        largest = max(largest, float(np.abs(percent).max()))
        box = _box(case.method, reproduction.names, values, percent, colours[case.method])
        figure.add_trace(box, row=levels.index(case.sigma_q2) + 1, col=1)
        figure.data[-1].showlegend = case.method not in shown
        shown.add(case.method)
    decades = 10.0 ** np.arange(np.ceil(np.log10(largest)) + 1)
    ticks = [*-decades[::-1], 0.0, *decades]
    words = [f"{tick:+g}" if tick else "true" for tick in ticks]
    figure.update_yaxes(tickvals=np.arcsinh(ticks).tolist(), ticktext=words, zeroline=True, zerolinecolor=BLUE)
    figure.update_xaxes(type="category", showticklabels=True, showgrid=False)
    return figure.update_layout(boxmode="group", hovermode="closest")


def _box(method: str, names: Sequence[str], values: Array, percent: Array, colour: str) -> go.Box:
    import plotly.graph_objects as go

    return go.Box(
        x=[_plain(name) for name in names for _ in values],
        y=np.arcsinh(percent).T.ravel().astype(np.float32),
        customdata=np.stack([values.T.ravel(), percent.T.ravel()], axis=1).astype(np.float32),
        hovertemplate="%{x}: %{customdata[0]:.4g} (%{customdata[1]:+.2f} %)",
        name=_plain(method_name(method)),
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


def torque_figure(log: LogValidation, joint: str, unit: str = "N m", points: int = 2000) -> go.Figure:
    """Draw a joint's measured and predicted torque over time, and their difference in a panel below.

    Samples outside the motion's mask are gaps; each curve is thinned to about ``points`` with its extremes kept.
    Raises InputError where the log has no such joint.
    """
    j = _column(log.motion, joint)
    measured = _only(log.motion.tau[:, j], log.motion.mask)
    predicted = _only(log.predicted[:, j], log.motion.mask)
    figure = _panels([f"{'force' if unit == 'N' else 'torque'}, {unit}", "residual"], 430, heights=[0.68, 0.32])
    curves = ("measured", measured, BLUE, 2.4, 1), ("predicted", predicted, RED, 1.2, 1)
    for name, values, colour, width, row in (*curves, ("residual", measured - predicted, INK, 1.0, 2)):
        line = {"color": colour, "width": width}
        figure.add_trace(_curve(log.motion.t, values, name, line, points), row=row, col=1)
    return figure


def motion_figure(motion: Motion, joint: str, unit: str = "rad", points: int = 2000) -> go.Figure:
    """Draw a joint's smoothed position, velocity and acceleration over time, one panel each.

    Samples outside the mask are gaps. Raises InputError where the motion has no such joint.
    """
    j = _column(motion, joint)
    figure = _panels([f"position, {unit}", f"velocity, {unit}/s", f"acceleration, {unit}/s²"], 480)
    for row, (name, colour) in enumerate((("q", BLUE), ("dq", GREEN), ("ddq", RED)), start=1):
        values = _only(getattr(motion, name)[:, j], motion.mask)
        line = {"color": colour, "width": 1.3}
        figure.add_trace(_curve(motion.t, values, name, line, points), row=row, col=1)
    return figure.update_layout(showlegend=False, margin={"t": 15})


def smoothing_figure(t: Array, measured: Array, smoothed: Sequence[Array], points: int = 4000) -> go.Figure:
    """Draw measured and smoothed values (N) over time, and below them the derivatives; ``smoothed`` holds all three."""
    figure = _panels(["value", "first derivative", "second derivative"], 540)
    figure.add_trace(_curve(t, measured, "measured", {"color": BLUE, "width": 2.4}, points), row=1, col=1)
    for row, (name, values) in enumerate(zip(("smoothed", "first", "second"), smoothed, strict=True), start=1):
        figure.add_trace(_curve(t, values, name, {"color": RED, "width": 1.2}, points), row=row, col=1)
    return figure


def parameter_figure(identification: Identification) -> go.Figure:
    """Draw the parameters with 95 % intervals (1.96 standard errors), one panel per unit.

    Parameters that the data do not determine (infinite standard error) are hollow and without a bar; a blue cross
    marks the true value where the model knows it.
    """
    estimate = identification.estimate
    units = list(dict.fromkeys(estimate.units))
    rows = [[i for i, of in enumerate(estimate.units) if of == unit] for unit in units]
    heights = [len(row) + 1.5 for row in rows]
    figure = _panels([""] * len(units), int(90 + 26 * sum(heights)), [_plain(u) for u in units], heights, shared=False)
    for number, row in enumerate(rows, start=1):
        for trace in _forest(identification, row, legend=number == 1):
            figure.add_trace(trace, row=number, col=1)
    figure.update_yaxes(type="category", autorange="reversed", showgrid=False)
    figure.update_xaxes(title="")
    return figure.update_layout(hovermode="closest")


def _forest(identification: Identification, row: list[int], legend: bool) -> Iterable[Any]:
    import plotly.graph_objects as go

    estimate = identification.estimate
    names = [_plain(estimate.names[i]) for i in row]
    value, std = np.asarray(estimate.value)[row], np.asarray(estimate.std)[row]
    sure = np.isfinite(std)
    yield go.Scatter(
        x=value,
        y=names,
        mode="markers",
        name="estimate and 95 % interval",
        showlegend=legend,
        marker={"color": RED, "size": 8, "symbol": ["circle" if ok else "circle-open" for ok in sure]},
        error_x={"array": np.where(sure, NORMAL_95 * std, np.nan), "color": RED, "thickness": 1.5, "width": 4},
        customdata=std,
        hovertemplate="%{y}: %{x:.4g}, standard error %{customdata:.2g}<extra></extra>",
    )
    true = {_plain(parameter.name): parameter.value for parameter in identification.model.parameters}
    known = [name for name in names if true.get(name) is not None]
    if known:
        yield go.Scatter(
            x=[true[name] for name in known],
            y=known,
            mode="markers",
            name="true value",
            showlegend=legend,
            marker={"color": BLUE, "size": 11, "symbol": "x-thin", "line": {"color": BLUE, "width": 2}},
            hovertemplate="%{y}: true value %{x:.4g}<extra></extra>",
        )


def _panels(
    titles: Sequence[str],
    height: int,
    headings: Sequence[str] | None = None,
    heights: Sequence[float] | None = None,
    shared: bool = True,
) -> go.Figure:
    """Return empty panels, one below the other; ``shared`` panels have one time axis and zoom together."""
    from plotly.subplots import make_subplots

    figure = make_subplots(
        rows=len(titles),
        cols=1,
        shared_xaxes=shared,
        vertical_spacing=(52 if headings else 18) / (height - 80) if len(titles) > 1 else 0,
        row_heights=heights,
        subplot_titles=headings,
    )
    for row, title in enumerate(titles, start=1):
        figure.update_yaxes(title=title, row=row, col=1)
    if shared and headings is None:
        figure.update_xaxes(title="time, s", row=len(titles), col=1)
    return figure.update_layout(template=_template(), height=height, margin_t=80 if headings else 40)


@cache
def _template() -> Any:
    import plotly.graph_objects as go

    axis = {"gridcolor": GRID, "zeroline": False, "linecolor": GRID, "showline": True, "automargin": True}
    return go.layout.Template(
        layout={
            "paper_bgcolor": "rgba(0, 0, 0, 0)",
            "plot_bgcolor": "rgba(0, 0, 0, 0)",
            "font": {"family": "inherit", "size": 13, "color": INK},
            "xaxis": axis,
            "yaxis": {**axis, "title": {"standoff": 8}},
            "margin": {"l": 55, "r": 12, "b": 45},
            "legend": {"orientation": "h", "x": 0, "y": 1, "yref": "container", "yanchor": "top"},
            "hovermode": "x unified",
            "modebar": {"bgcolor": "rgba(0, 0, 0, 0)", "color": "rgba(128, 128, 128, 0.6)", "activecolor": INK},
            "hoverlabel": {"bgcolor": "#f6f6f6", "bordercolor": "#b0b0b0", "font": {"color": "#1a1a1a"}},
        }
    )


def _curve(t: Array, y: Array, name: str, line: Mapping[str, Any], points: int = 2000) -> Any:
    import plotly.graph_objects as go

    t, y = thin(t, y, points)
    single = t.astype(np.float32)
    return go.Scatter(
        x=single if (np.diff(single) > 0).all() else t,
        y=y.astype(np.float32),
        name=name,
        mode="lines",
        line=dict(line),
        meta="ink" if line["color"] == INK else None,
        hovertemplate="%{y:.4g}",
    )


def _only(values: Array, keep: NDArray[np.bool_]) -> Array:
    return np.where(keep, values, np.nan)


def _plain(name: str) -> str:
    """Escape a name for plotly, which reads a few HTML tags in its texts."""
    return escape(name, quote=False)


def _colours(methods: Iterable[str]) -> dict[str, str]:
    names = list(dict.fromkeys(methods))
    others = [name for name in names if name not in COLOURS]
    return COLOURS | {name: MORE[i % len(MORE)] for i, name in enumerate(others)}


def _column(motion: Motion, joint: str) -> int:
    if joint not in motion.joints:
        raise InputError(f"{motion.source}: no joint {joint!r}; {choices(joint, motion.joints)}")
    return motion.joints.index(joint)


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
