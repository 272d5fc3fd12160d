"""The figures of the page, as plain data; curves are thinned, extremes kept, and finest where a person has zoomed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dynident.report.figures.canvas import (
    AMBER,
    BLUE,
    GREEN,
    INK,
    PALE,
    RED,
    TIME,
    Array,
    Drawing,
    Trace,
    curve,
    only,
    origin,
    panels,
    thin,
    trace,
)

if TYPE_CHECKING:
    from dynident.tuning import DegreeCurve, LogFit, Smoothed

__all__ = ["SLIDER", "Zoom", "curve_drawing", "motion_drawing", "residual_drawing", "torque_drawing"]

Zoom = tuple[float, float] | None  # s of the log, None for all of it
POINTS, COARSE, AROUND = 1400, 600, 120  # of a curve: where it is seen, while a slider moves, on either side
SLIDER = -3.0, 4.0  # log S/n, from one end of the slider to the other
NEAR, CLOSE = 0.12, 1.0  # of log S/n: marks that are one, and whose names would meet
PREFIXES = (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")
LEFT_OUT = "rgba(128, 128, 128, 0.18)"
MARGIN = {"l": 72, "r": 8, "t": 8, "b": 40}


def motion_drawing(
    one: Smoothed, unit: str, left_out: Sequence[tuple[float, float]], zoom: Zoom = None, *, fine: bool = True
) -> Drawing:
    """Draw a joint's measured and smoothed position, what was taken away, velocity and acceleration over time.

    Windows that are ``left_out`` (s) are grey, samples outside the mask gaps of what is smoothed; curves that are not
    ``fine`` have fewer points.
    """
    size, prefix = _prefix(one.noise)
    titles = [f"position, {unit}", f"taken away, {prefix}{unit}", f"velocity, {unit}/s", f"acceleration, {unit}/s²"]
    figure = panels(titles, 640, heights=[0.28, 0.2, 0.24, 0.28])
    zero = origin(one.t)
    drawn = (
        (1, "measured", one.measured, PALE, 3.5),
        (1, "smoothed", one.q, BLUE, 1.3),
        (2, "measured minus smoothed", only(one.residual / size, one.mask), INK, 0.8),
        (3, "velocity", only(one.dq, one.mask), GREEN, 1.3),
        (4, "acceleration", only(one.ddq, one.mask), RED, 1.3),
    )
    for row, name, values, colour, width in drawn:
        line = _line(one.t, values, name, {"color": colour, "width": width}, zoom, zero, POINTS if fine else COARSE)
        figure.add(line | {"showlegend": row == 1}, row=row)
    return _timed(figure, left_out, zero, rows=4, of=f"{one.log}/{one.joint}")


def torque_drawing(
    log: LogFit, joint: int, unit: str, left_out: Sequence[tuple[float, float]], zoom: Zoom = None
) -> Drawing:
    """Draw a joint's measured and predicted torque over time, and their difference below."""
    motion = log.motion
    measured, guess = motion.tau[:, joint], only(log.predicted[:, joint], motion.mask)
    figure = panels([f"{'force' if unit == 'N' else 'torque'}, {unit}", f"residual, {unit}"], 300, heights=[0.66, 0.34])
    zero = origin(motion.t)
    for name, values, colour, width, row in (
        ("measured", measured, BLUE, 2.2, 1),
        ("predicted", guess, RED, 1.1, 1),
        ("residual", measured - guess, INK, 0.8, 2),
    ):
        line = _line(motion.t, values, name, {"color": colour, "width": width}, zoom, zero)
        figure.add(line | {"showlegend": row == 1}, row=row)
    return _timed(figure, left_out, zero, rows=2, of=f"{log.name}/{joint}")


def residual_drawing(one: Smoothed, unit: str) -> Drawing:
    """Draw the power spectral density of what the smoothing takes away, and its autocorrelation, side by side."""
    figure = panels(["", ""], 260, shared=False)
    f, power = one.spectrum()
    lags, auto, white = one.autocorrelation()
    good = power > 0
    f, power = thin(f[good], power[good], 500)
    figure.add(_plain_line(f, power, "spectrum", INK))
    figure.add(_plain_line(lags, auto, "autocorrelation", INK), row=2)
    x, y = {"type": "log", "title": {"text": "frequency, Hz"}, "dtick": 1}, {"type": "log", "exponentformat": "power"}
    figure.layout["xaxis"] |= {"domain": [0.0, 0.44], "anchor": "y"} | x
    figure.layout["yaxis"] |= {"domain": [0.0, 1.0], "title": {"text": f"power, {unit}²/Hz"}, "nticks": 5} | y
    figure.layout["xaxis2"] |= {"domain": [0.58, 1.0], "anchor": "y2", "title": {"text": "lag, s"}}
    figure.layout["yaxis2"] |= {"domain": [0.0, 1.0], "title": {"text": "autocorrelation"}}
    shapes = []
    if np.isfinite(one.cutoff) and one.cutoff > 0:
        shapes.append(_across("x", "y domain", one.cutoff))
        figure.layout["annotations"] = [_note("cut-off", float(np.log10(one.cutoff)), "x")]
    if np.isfinite(white):
        shapes.append(_band(white))
    figure.layout.update(shapes=shapes, showlegend=False, margin=MARGIN, hovermode="x", font={"size": 12})
    return figure


def curve_drawing(found: DegreeCurve, at: float, joint: int, alone: bool) -> Drawing:
    """Draw the cross-validated error over the degree of smoothing, the marks, and where the setting is (``at``)."""
    figure = panels([""], 170, shared=False)
    figure.add(_plain_line(found.degrees, found.errors, "cross-validated error", BLUE, 2.0))
    marks = _marks(found, joint, alone)
    x = np.array([degree for degree, _ in marks])
    y = np.interp(x, found.degrees, found.errors)
    figure.add(
        trace(
            "scatter",
            x=x,
            y=y,
            text=[name for _, name in marks],
            mode="markers+text",
            textposition=_sides(x, np.interp(x + NEAR, found.degrees, found.errors) > y),
            textfont={"size": 11},
            cliponaxis=False,
            name="choices",
            marker={"color": AMBER, "size": 8, "symbol": "diamond"},
            hovertemplate="%{text}: log S/n = %{x:.2f}, %{y:.3g} %<extra></extra>",
        )
    )
    figure.layout["shapes"] = [_across("x", "y domain", at, BLUE)]
    figure.layout["xaxis"] |= {"title": {"text": "log S/n"}, "range": list(SLIDER), "dtick": 1, "automargin": False}
    figure.layout["yaxis"] |= {"nticks": 4, "ticksuffix": " %", "automargin": False}
    figure.layout.update(
        showlegend=False, margin={"l": 46, "r": 10, "t": 14, "b": 36}, hovermode="closest", dragmode=False
    )
    figure.layout["font"] = {"size": 11}
    return figure


def _marks(found: DegreeCurve, joint: int, alone: bool) -> list[tuple[float, str]]:
    """Return where marks stand, in order, and their names; those in one place are one."""
    known: list[tuple[float, str]] = []
    for degree, name in sorted((place(degrees, joint, alone), name) for name, degrees in found.marks.items()):
        if known and degree - known[-1][0] < NEAR:
            known[-1] = known[-1][0], f"{known[-1][1]}, {name}"
        else:
            known.append((degree, name))
    return known


def _sides(x: Array, rising: NDArray[np.bool_]) -> list[str]:
    """Return where the name of each mark stands: away from the curve, and from the next mark where that is close."""
    close = np.append(np.diff(x) < CLOSE, False)
    sides = {(True, True): "top left", (True, False): "bottom right", (False, True): "bottom left"}
    return [sides.get((bool(up), bool(near)), "top right") for up, near in zip(rising, close, strict=True)]


def place(degrees: Sequence[float], joint: int, alone: bool) -> float:
    """Return where a mark stands: at the degree of the joint, or, of all together, at the middle one."""
    return float(degrees[joint]) if alone else float(np.median(np.asarray(degrees)))


def _prefix(noise: float) -> tuple[float, str]:
    """Return the unit, by size and prefix, for what noise leaves: the same however much is smoothed."""
    return next(((size, prefix) for size, prefix in PREFIXES if noise >= 0.1 * size), PREFIXES[-1])


def _line(t: Array, y: Array, name: str, line: dict[str, Any], zoom: Zoom, zero: float, points: int = POINTS) -> Trace:
    """Return a thinned curve, with most points where it is seen."""
    if zoom is None or len(t) <= points:
        return curve(t - zero, y, name, line, points)
    ends = np.searchsorted(t, zoom)
    first, last = max(int(ends[0]) - 1, 0), min(int(ends[1]) + 1, len(t))
    parts = [(slice(0, first), AROUND), (slice(first, last), points), (slice(last, None), AROUND)]
    pieces = [thin(t[part], y[part], most) for part, most in parts if len(t[part])]
    x, values = (np.concatenate(columns) for columns in zip(*pieces, strict=True))
    return curve(x - zero, values, name, line, len(x) + 8)


def _plain_line(x: Array, y: Array, name: str, colour: str, width: float = 1.0) -> Trace:
    line = {"color": colour, "width": width}
    return trace("scatter", x=x, y=y, name=name, mode="lines", line=line, meta="ink" if colour == INK else None)


def _timed(figure: Drawing, left_out: Sequence[tuple[float, float]], zero: float, rows: int, of: str) -> Drawing:
    """Return a figure over time with what is left out in grey."""
    last = f"x{rows}"
    box = {"type": "rect", "xref": last, "yref": "paper", "y0": 0, "y1": 1, "line": {"width": 0}, "layer": "below"}
    figure.layout["shapes"] = [
        {**box, "x0": start - zero, "x1": stop - zero, "fillcolor": LEFT_OUT} for start, stop in left_out
    ]
    title = f"time since {zero:.0f} s, s" if zero else TIME
    figure.layout[f"xaxis{rows}"]["title"] = {"text": title}
    figure.axes("y", exponentformat="power", nticks=6, automargin=False)  # margins that follow the labels take time
    figure.axes("x", automargin=False)
    figure.layout.update(margin={**MARGIN, "t": 30}, selectdirection="h", uirevision=of, font={"size": 12})
    return figure


def _across(x: str, y: str, at: float, colour: str = PALE) -> dict[str, Any]:
    line = {"color": colour, "width": 1.5, "dash": "dot"}
    return {"type": "line", "xref": x, "yref": y, "x0": at, "x1": at, "y0": 0, "y1": 1, "line": line}


def _band(size: float) -> dict[str, Any]:
    shape = {"type": "rect", "xref": "x2 domain", "yref": "y2", "x0": 0, "x1": 1, "y0": -size, "y1": size}
    return {**shape, "line": {"width": 0}, "fillcolor": LEFT_OUT, "layer": "below"}


def _note(text: str, x: float, axis: str) -> dict[str, Any]:
    place = {"xref": axis, "x": x, "yref": "y domain", "y": 1, "yanchor": "top", "xanchor": "left"}
    return {"text": text, "showarrow": False, "font": {"size": 11}, **place}
