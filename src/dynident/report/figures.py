"""What all figures share: colours, panels, curves, and thinning that keeps the extremes.

A figure is the plain data that plotly's JavaScript draws: plotly for Python, which checks it, takes 15 ms a panel.
"""

from __future__ import annotations

import json
import math
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from dynident.runtime import InputError, Noun, escape_acting, install_command
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    import plotly.graph_objects as go

Trace = dict[str, Any]

INK = "#7d7d7d"
# told apart with each colour-blindness, and at least 3 : 1 against white and against the dark paper of the page
BLUE, RED, GREEN, AMBER, VIOLET = "#2964c4", "#bf3a10", "#33a38f", "#b98a00", "#9a66d0"
GRID = "rgba(128, 128, 128, 0.25)"
PALE = "rgba(128, 128, 128, 0.5)"
TIME = "time, s"  # an axis
MAX_START_LENGTHS = 100.0  # lengths of a log from which on its stamps are far from zero
CLOCK_RANGE = 946_684_800.0, 4_102_444_800.0  # s: stamps from 2000 to 2100, counted from 1970
MAX_PAGE_POINTS = 200_000  # of all curves of a page; a point takes 11 bytes there
AXIS = {"gridcolor": GRID, "zeroline": False, "linecolor": GRID, "showline": True, "automargin": True}
PACKED_TYPES = ("f4", "f8", "i1", "i2", "i4")  # types of the arrays that plotly reads in base 64
TEMPLATE = {
    "layout": {
        "paper_bgcolor": "rgba(0, 0, 0, 0)",
        "plot_bgcolor": "rgba(0, 0, 0, 0)",
        "font": {"family": "inherit", "size": 13, "color": INK},
        "xaxis": AXIS,
        "yaxis": {**AXIS, "title": {"standoff": 8}},
        "margin": {"l": 55, "r": 12, "b": 45},
        "legend": {"orientation": "h", "x": 0, "y": 1, "yref": "container", "yanchor": "top"},
        "hovermode": "x unified",
        "modebar": {"bgcolor": "rgba(0, 0, 0, 0)", "color": "rgba(128, 128, 128, 0.6)", "activecolor": INK},
        "hoverlabel": {"bgcolor": "#f6f6f6", "bordercolor": "#b0b0b0", "font": {"color": "#1a1a1a"}},
    }
}

EXTRA_COLOURS = ("#00909e", "#d0569b", "#7a8a00")
METHOD_COLOURS = {"simulated": BLUE, "spline": RED, "filtered": INK, "raw": AMBER, "spline-early": VIOLET, "ml": GREEN}
METHOD_NAMES = {
    "raw": "raw differences", "filtered": "filtered differences", "spline": "smoothing splines",
    "spline-early": "early-cut splines", "ml": "maximum likelihood",
}  # fmt: skip


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
    gaps = bool(np.isnan(y).any())
    # Each bucket yields its minimum and maximum, and one gap where there are gaps
    width = -(-len(t) // ((points - 2) // (3 if gaps else 2)))
    # Pad the last bucket with the last value; what is picked from the padding is dropped below
    rows = np.full((-(-len(t) // width), width), np.nan if gaps else y[-1])
    rows.flat[: len(t)] = y
    picks = [rows.argmin(axis=1), rows.argmax(axis=1)]
    if gaps:
        # NaN would win both comparisons: look for the extremes without it, and keep one NaN per bucket as the gap
        hole = np.isnan(rows)
        picks = [np.where(hole, np.inf, rows).argmin(axis=1), np.where(hole, -np.inf, rows).argmax(axis=1)]
        picks.append(hole.argmax(axis=1))
    starts = width * np.arange(len(rows))
    index = np.unique(np.concatenate([[0, len(t) - 1], *(starts + pick for pick in picks)]))
    index = index[index < len(t)]  # the last bucket may not be full
    return t[index], y[index]


class Drawing(Noun):
    """A figure as plotly's JavaScript reads it: its ``data``, a list of traces, and its ``layout``.

    ``motion`` is what the page moves its first traces by, None where nothing moves.
    """

    data: list[Trace]
    layout: dict[str, Any]
    motion: dict[str, Any] | None = None

    def add(self, trace: Trace, row: int = 1) -> None:
        """Add a trace to a panel, counted from above."""
        self.data.append({**trace, "xaxis": _axis_name("x", row), "yaxis": _axis_name("y", row)})

    def axes(self, letter: Literal["x", "y"], title: str | None = None, **changes: Any) -> None:
        """Change the axes x or y of all panels, and their title, where one is given."""
        for axis in (self.layout[key] for key in self.layout if key.startswith(f"{letter}axis")):
            axis.update(_without_none({**changes, "title": None if title is None else {"text": title}}))

    def follow_run(self, run: str) -> Drawing:
        """Tie the figure to the time of a recording, along which the page moves the arm, and return it."""
        self.layout["meta"] = {"run": run}
        return self

    def json(self) -> str:
        """Return the text that plotly's JavaScript reads."""
        content = {"data": self.data, "layout": self.layout} | ({"motion": self.motion} if self.motion else {})
        return json.dumps(_json_value(content), separators=(",", ":"), allow_nan=False)

    def figure(self) -> go.Figure:
        """Return the figure of plotly for Python, which checks it; InputError where that is not installed."""
        try:
            import plotly.graph_objects as go
        except ImportError as error:
            words = "figures in Python need plotly (the extra `dynident[notebook]`)"
            raise InputError(f"{words}; install it: {install_command('plotly')}") from error

        return go.Figure(self.data, self.layout)


def panels(
    titles: Sequence[str],
    height: int,
    headings: Sequence[str] | None = None,
    heights: Sequence[float] | None = None,
    shared: bool = True,
) -> Drawing:
    """Return empty panels, one below the other; ``shared`` panels have one time axis and zoom together."""
    count = len(titles)
    gap = (52 if headings else 18) / (height - 80) if count > 1 else 0.0
    sizes = np.array([1.0] * count if heights is None else heights)
    sizes *= (1 - gap * (count - 1)) / sizes.sum()
    # Domains are shares of the height, counted from below; panels are counted from above
    tops = 1 - np.cumsum([0.0, *(sizes[:-1] + gap)])
    layout: dict[str, Any] = {"template": TEMPLATE, "height": height, "margin": {"t": 80 if headings else 40}}
    for row, (title, top, size) in enumerate(zip(titles, tops.tolist(), sizes.tolist(), strict=True), start=1):
        x: dict[str, Any] = {"anchor": _axis_name("y", row), "domain": [0.0, 1.0]}
        if shared and row < count:
            x |= {"matches": _axis_name("x", count), "showticklabels": False}
        elif shared and headings is None:
            x["title"] = {"text": TIME}
        layout[_axis_name("xaxis", row)] = x
        domain = [max(top - size, 0.0), top]
        layout[_axis_name("yaxis", row)] = {"anchor": _axis_name("x", row), "domain": domain, "title": {"text": title}}
    if headings:
        layout["annotations"] = [_heading(text, top) for text, top in zip(headings, tops.tolist(), strict=True)]
    return Drawing([], layout)


def _json_value(value: Any) -> Any:
    """Return a property as JSON has it: arrays as plotly packs them, numbers that are not finite as null."""
    if isinstance(value, dict):
        return {name: _json_value(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(entry) for entry in value]
    if isinstance(value, np.generic):
        return _json_value(value.item())
    if isinstance(value, np.ndarray):
        return _pack_array(value) if value.size else []
    if isinstance(value, str):
        return escape_acting(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _pack_array(values: NDArray[Any]) -> Any:
    if values.dtype.kind == "i":
        # The smallest type that holds all values keeps the page small
        values = values.astype(np.min_scalar_type(min(int(values.min()), -int(values.max()) - 1)))
    kind = f"{values.dtype.kind}{values.dtype.itemsize}"
    if kind not in PACKED_TYPES:
        return _json_value(values.tolist())
    encoded = {"dtype": kind, "bdata": b64encode(values.tobytes()).decode("ascii")}
    return encoded if values.ndim == 1 else encoded | {"shape": ", ".join(map(str, values.shape))}


def _axis_name(name: str, row: int) -> str:
    """Return the name of a panel's axis: that of the first panel has no number."""
    return f"{name}{row}" if row > 1 else name


def _heading(text: str, top: float) -> dict[str, Any]:
    place = {"x": 0.5, "xanchor": "center", "xref": "paper", "y": top, "yanchor": "bottom", "yref": "paper"}
    return {"text": text, "showarrow": False, "font": {"size": 16}, **place}


def curve(t: Array, y: Array, name: str, line: Mapping[str, Any], points: int = 2000) -> Trace:
    """Return a thinned line of y (N) over t (N); nan values are gaps."""
    t, y = thin(t, y, points)
    with np.errstate(over="ignore", invalid="ignore"):  # values beyond single precision leave the figure
        single, values = t.astype(np.float32), y.astype(np.float32)
        # Times must still rise in single precision, else neighbouring samples would coincide
        rising = (np.diff(single) > 0).all()
    times, look = single if rising else t, {"mode": "lines", "line": dict(line)}
    return trace("scatter", x=times, y=values, name=name, **look, hovertemplate="%{y:.4g}")


def mark_rows(figure: Drawing, labels: list[str], series: Iterable[tuple[Array, str, str, str]], title: str) -> None:
    """Add marks of positive values (%) on a logarithmic axis with a ``title``, one row per label.

    Each of the ``series`` has values, name, colour and symbol. Other values and infinite ones are left out.
    """
    rows = np.arange(len(labels))
    for values, name, colour, symbol in series:
        good = np.isfinite(values) & (values > 0)
        marker = {"color": colour, "size": 9, "symbol": symbol, "line": {"width": 1.6}}
        look: Trace = {"mode": "markers", "name": name, "marker": marker}
        look |= {"text": [labels[k] for k in np.flatnonzero(good)], "hovertemplate": "%{text}: %{x:.3g} %"}
        figure.add(trace("scatter", x=values[good], y=rows[good], **look))
    figure.axes("y", tickvals=rows, ticktext=labels, range=[len(labels) - 0.5, -0.5])
    figure.axes("x", type="log", title=title, dtick=1, exponentformat="power")
    figure.layout.update(hovermode="closest")


def trace(kind: str, **properties: Any) -> Trace:
    """Return a trace with the properties that are not None."""
    return {"type": kind, **_without_none(properties)}


def _without_none(properties: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in properties.items() if value is not None}


def time_origin(t: Array) -> float:
    """Return the time (s) from which a figure counts: zero, or the first stamp where stamps are far from zero.

    Such stamps count from 1970, or from when a machine was started; no reader can tell them apart at an axis.
    """
    return float(np.floor(t[0])) if abs(t[0]) > MAX_START_LENGTHS * (t[-1] - t[0]) else 0.0


def clock(t: float) -> str:
    """Return a stamp (s) that counts from 1970 as a time of day, such as "2016-04-07 13:43:10 UTC"; "" for others."""
    from datetime import UTC, datetime

    is_date = CLOCK_RANGE[0] < t < CLOCK_RANGE[1]
    return datetime.fromtimestamp(t, UTC).strftime("%Y-%m-%d %H:%M:%S UTC") if is_date else ""


def with_gaps(values: Array, keep: NDArray[np.bool_]) -> Array:
    """Return values (N) with NaN where ``keep`` is false, which a curve shows as gaps."""
    return np.where(keep, values, np.nan)


def plain(name: str) -> str:
    """Escape a name for plotly, which reads a few HTML tags in its texts."""
    return escape(name, quote=False)


def points_per_curve(curves: int) -> int:
    """Return the points for each of ``curves`` curves, at most 4000, so that those of a page take about 2 MB."""
    return int(np.clip(MAX_PAGE_POINTS // max(curves, 1), 100, 4000))


def method_name(method: str) -> str:
    """Return the name of a smoothing method of the article, e.g. "raw" -> "raw differences"; others stay."""
    return METHOD_NAMES.get(method, method)


def scientific(value: float) -> str:
    """Format a noise level as the article does, 1e-8 and 1e-4, without padding."""
    mantissa, exponent = f"{value:e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def method_colours(methods: Iterable[str]) -> dict[str, str]:
    """Return a colour for each method, the same ones in every figure."""
    names = list(dict.fromkeys(methods))
    extra_names = [name for name in names if name not in METHOD_COLOURS]
    return METHOD_COLOURS | {name: EXTRA_COLOURS[i % len(EXTRA_COLOURS)] for i, name in enumerate(extra_names)}
