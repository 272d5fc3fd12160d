"""What all figures share: colours, panels, curves, and thinning that keeps the extremes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError

if TYPE_CHECKING:
    import plotly.graph_objects as go

__all__ = [
    "AMBER",
    "BLUE",
    "GREEN",
    "GRID",
    "INK",
    "PALE",
    "RED",
    "Array",
    "curve",
    "only",
    "origin",
    "panels",
    "plain",
    "share",
    "thin",
]

Array = NDArray[np.float64]

INK = "#7d7d7d"
BLUE, RED, GREEN, AMBER = "#3584e4", "#e5484d", "#2e9e5b", "#c98500"
GRID = "rgba(128, 128, 128, 0.25)"
PALE = "rgba(128, 128, 128, 0.5)"
FAR = 100.0  # lengths of a log from which on its stamps are far from zero
ALL_POINTS = 300_000  # of all curves of a page; a point takes 11 bytes there


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


def panels(
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


def curve(t: Array, y: Array, name: str, line: Mapping[str, Any], points: int = 2000) -> Any:
    """Return a thinned line of y (N) over t (N); nan values are gaps."""
    import plotly.graph_objects as go

    t, y = thin(t, y, points)
    with np.errstate(over="ignore", invalid="ignore"):  # values beyond single precision leave the figure
        single, values = t.astype(np.float32), y.astype(np.float32)
        rising = (np.diff(single) > 0).all()
    return go.Scatter(
        x=single if rising else t,
        y=values,
        name=name,
        mode="lines",
        line=dict(line),
        meta="ink" if line["color"] == INK else None,
        hovertemplate="%{y:.4g}",
    )


def origin(t: Array) -> float:
    """Return the time (s) from which a figure counts: that of the axis, but for stamps far from zero their first one.

    Such stamps count from 1970, or from when a machine was started; no reader can tell them apart at an axis.
    """
    return float(np.floor(t[0])) if abs(t[0]) > FAR * (t[-1] - t[0]) else 0.0


def only(values: Array, keep: NDArray[np.bool_]) -> Array:
    """Return values (N) with nan where they are not kept."""
    return np.where(keep, values, np.nan)


def plain(name: str) -> str:
    """Escape a name for plotly, which reads a few HTML tags in its texts."""
    return escape(name, quote=False)


def share(curves: int) -> int:
    """Return the points for each of so many curves, at most 4000, so that a page of all of them stays near 3 MB."""
    return int(np.clip(ALL_POINTS // max(curves, 1), 100, 4000))
