"""Figures of the page, as plain data; curves are thinned, extremes kept, and finest where the user has zoomed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dynident.apps.tuning.curve import DegreeCurve, SmoothedJoint
from dynident.apps.tuning.quick_fit import LogPrediction
from dynident.report import Array, Drawing, thin
from dynident.report.figures import (
    AMBER,
    BLUE,
    GREEN,
    PALE,
    RED,
    TIME,
    VIOLET,
    Trace,
    curve,
    panels,
    plain,
    time_origin,
    trace,
    with_gaps,
)
from dynident.runtime import shorten_names

Zoom = tuple[float, float] | None  # s of the log, None for all of it
Curve = tuple[int, str, Array, str, float]  # row, name, values, colour, width
INK = "#111111"  # of residuals, as of text
# of a curve: where it is seen, while a slider moves, on either side
MAX_POINTS, MAX_COARSE_POINTS, MAX_HIDDEN_POINTS = 1400, 600, 120
SLIDER_RANGE = -3.0, 4.0  # log S/n, from one end of the slider to the other
MARK_MERGE_DISTANCE = 0.12  # of log S/n: marks that are one
LETTER_WIDTH, NAME_PADDING = 0.25, 0.4  # of log S/n, on the narrowest page: of a letter of a name, and beside it
LEFT_OUT_COLOUR = "rgba(128, 128, 128, 0.18)"
OTHER_SETTING = "other setting"
LOOP_COLOURS = {2: (PALE, RED), 3: (PALE, AMBER, RED)}
MAX_TITLE_LENGTH = 16  # letters of the name of a column beside its axis
MARGIN = {"l": 72, "r": 8, "t": 8, "b": 40}


def motion_drawing(
    smoothed: SmoothedJoint, unit: str, left_out: Sequence[tuple[float, float]], zoom: Zoom = None, *,
    fine: bool = True, beside: tuple[str, Array] | None = None,
) -> Drawing:  # fmt: skip
    """Draw a joint's measured and smoothed position, their difference, velocity and acceleration over time, and what
    stands ``beside``: another column of the recording, its name and values (N).

    Windows that are ``left_out`` (s) are grey, and curves have gaps at samples outside the mask; curves that
    are not ``fine`` have fewer points.
    """
    titles = [f"position, {unit}", f"taken away, {unit}", f"velocity, {unit}/s", f"acceleration, {unit}/s²"]
    curves: list[Curve] = [
        (1, "measured", smoothed.measured, PALE, 3.5),
        (1, "smoothed", smoothed.q, BLUE, 1.3),
        (2, "measured minus smoothed", with_gaps(smoothed.residual, smoothed.mask), INK, 0.8),
        (3, "velocity", with_gaps(smoothed.dq, smoothed.mask), GREEN, 1.3),
        (4, "acceleration", with_gaps(smoothed.ddq, smoothed.mask), RED, 1.3),
    ]
    heights = [0.28, 0.2, 0.24, 0.28]
    if beside is not None:
        name, values = beside
        titles.append(plain(shorten_names([name], MAX_TITLE_LENGTH)[0]))
        curves.append((5, plain(name), values, VIOLET, 1.2))
        heights.append(0.26)
    figure = panels(titles, 640 if beside is None else 790, heights=heights)
    points = MAX_POINTS if fine else MAX_COARSE_POINTS
    of = f"{smoothed.log}/{smoothed.joint}"
    _draw_over_time(figure, smoothed.t, curves, left_out, zoom, points, of)
    figure.layout["yaxis2"] |= {"exponentformat": "SI"}
    return figure


def torque_drawing(
    log: LogPrediction, joint: int, unit: str, left_out: Sequence[tuple[float, float]], zoom: Zoom = None,
    other: LogPrediction | None = None,
) -> Drawing:  # fmt: skip
    """Draw a joint's measured and predicted torque over time, and their difference below.

    What an ``other`` setting predicts of the same samples lies below both.
    """
    motion = log.motion
    measured, predicted = motion.tau[:, joint], with_gaps(log.predicted[:, joint], motion.mask)
    titles = [f"{'force' if unit == 'N' else 'torque'}, {unit}", f"residual, {unit}"]
    curves: list[Curve] = [
        (1, "measured", measured, BLUE, 2.2),
        (1, "predicted", predicted, RED, 1.1),
        (2, "residual", measured - predicted, INK, 0.8),
    ]
    if other is not None and len(other.predicted) == len(measured):
        before = with_gaps(other.predicted[:, joint], other.motion.mask)
        curves[1:1] = [(1, OTHER_SETTING, before, AMBER, 1.6), (2, OTHER_SETTING, measured - before, AMBER, 1.2)]
    figure = panels(titles, 300, heights=[0.66, 0.34])
    return _draw_over_time(figure, motion.t, curves, left_out, zoom, MAX_POINTS, f"{log.name}/{joint}")


def loop_drawing(loops: Mapping[str, tuple[Array, Array]], unit: str, speed_unit: str) -> Drawing:
    """Draw torques (N) over velocities (N) by name, without the torque of the bodies: the loop of the friction."""
    figure = panels([f"{'force' if unit == 'N' else 'torque'}, {unit}"], 260, shared=False)
    for (name, (velocity, torque)), colour in zip(loops.items(), LOOP_COLOURS[len(loops)], strict=True):
        step = -(-len(velocity) // MAX_POINTS)
        x, y = (values[::step].astype(np.float32) for values in (velocity, torque))
        figure.add(trace("scatter", x=x, y=y, name=name, mode="markers", marker={"color": colour, "size": 3}))
    figure.axes("x", title=f"velocity, {speed_unit}", automargin=False)
    figure.axes("y", exponentformat="power", nticks=6, automargin=False)
    figure.layout.update(margin={**MARGIN, "t": 30}, hovermode="closest", font={"size": 12}, showlegend=True)
    return figure


def residual_drawing(smoothed: SmoothedJoint, unit: str) -> Drawing:
    """Draw the power spectral density of what the smoothing removes, and its autocorrelation, side by side."""
    figure = panels(["", ""], 260, shared=False)
    f, power = smoothed.spectrum()
    lags, correlation, white = smoothed.autocorrelation()
    # a logarithmic axis has no place for zero
    is_positive = power > 0
    f, power = thin(f[is_positive], power[is_positive], 500)
    figure.add(_plain_line(f, power, "spectrum", INK))
    figure.add(_plain_line(lags, correlation, "autocorrelation", INK), row=2)
    x, y = {"type": "log", "title": {"text": "frequency, Hz"}, "dtick": 1}, {"type": "log", "exponentformat": "power"}
    figure.layout["xaxis"] |= {"domain": [0.0, 0.44], "anchor": "y"} | x
    figure.layout["yaxis"] |= {"domain": [0.0, 1.0], "title": {"text": f"power, {unit}²/Hz"}, "nticks": 5} | y
    figure.layout["xaxis2"] |= {"domain": [0.58, 1.0], "anchor": "y2", "title": {"text": "lag, s"}}
    figure.layout["yaxis2"] |= {"domain": [0.0, 1.0], "title": {"text": "autocorrelation"}}
    shapes = []
    if np.isfinite(smoothed.cutoff) and smoothed.cutoff > 0:
        shapes.append(_vertical_line(smoothed.cutoff))
        place = {"xref": "x", "x": float(np.log10(smoothed.cutoff)), "yref": "y domain", "y": 1}
        place |= {"yanchor": "top", "xanchor": "left"}
        figure.layout["annotations"] = [{"text": "cut-off", "showarrow": False, "font": {"size": 11}, **place}]
    if np.isfinite(white):
        band = {"type": "rect", "xref": "x2 domain", "yref": "y2", "x0": 0, "x1": 1, "y0": -white, "y1": white}
        shapes.append({**band, "line": {"width": 0}, "fillcolor": LEFT_OUT_COLOUR, "layer": "below"})
    figure.layout.update(shapes=shapes, showlegend=False, margin=MARGIN, hovermode="x", font={"size": 12})
    return figure


def curve_drawing(degree_curve: DegreeCurve, at: float, joint: int, alone: bool) -> Drawing:
    """Draw the cross-validated error over the degree of smoothing, the marks, and the current setting (``at``)."""
    figure = panels([""], 170, shared=False)
    figure.add(_plain_line(degree_curve.degrees, degree_curve.errors, "cross-validated error", BLUE, 2.0))
    marks = _marks(degree_curve, joint, alone)
    x = np.array([degree for degree, _ in marks])
    y, names = np.interp(x, degree_curve.degrees, degree_curve.errors), [name for _, name in marks]
    marker = {"color": AMBER, "size": 8, "symbol": "diamond"}
    hover = "%{text}: log S/n = %{x:.2f}, %{y:.3g} %<extra></extra>"
    look = {"mode": "markers", "name": "choices", "marker": marker, "hovertemplate": hover}
    figure.add(trace("scatter", x=x, y=y, text=names, **look))
    labels, level_count = _mark_labels(marks)
    figure.layout["annotations"] = labels
    figure.layout["shapes"] = [*(_vertical_line(degree) for degree, _ in marks), _vertical_line(at, BLUE)]
    figure.axes("x", title="log S/n", range=list(SLIDER_RANGE), dtick=1, automargin=False)
    figure.layout["yaxis"] |= {"nticks": 4, "ticksuffix": " %", "automargin": False}
    margin = {"l": 46, "r": 10, "t": 4 + 14 * level_count, "b": 36}
    figure.layout.update(showlegend=False, margin=margin, hovermode="closest", dragmode=False)
    figure.layout["font"] = {"size": 11}
    return figure


def _marks(degree_curve: DegreeCurve, joint: int, alone: bool) -> list[tuple[float, str]]:
    """Return the positions and names of the marks in order; marks at one place are merged."""
    marks: list[tuple[float, str]] = []
    # a mark is at the degree of the joint or, for all together, at the median
    places = {name: x[joint] if alone else float(np.median(x)) for name, x in degree_curve.marks.items()}
    for degree, name in sorted((degree, name) for name, degree in places.items()):
        # marks closer than the width of a symbol are one, with all names
        if marks and degree - marks[-1][0] < MARK_MERGE_DISTANCE:
            marks[-1] = marks[-1][0], f"{marks[-1][1]}, {name}"
        else:
            marks.append((degree, name))
    return marks


def _mark_labels(marks: Sequence[tuple[float, str]]) -> tuple[list[dict[str, Any]], int]:
    """Return the names of the marks above the curve, in as many levels as keep them apart, and how many these are."""
    ends, labels = list[float](), []
    for degree, name in marks:
        half = 0.5 * (NAME_PADDING + LETTER_WIDTH * len(name))
        centre = float(np.clip(degree, SLIDER_RANGE[0] + half, SLIDER_RANGE[1] - half))
        level = next((k for k, end in enumerate(ends) if end < centre - half), len(ends))
        ends[level : level + 1] = [centre + half]
        position = {"xref": "x", "x": centre, "yref": "y domain", "y": 1, "yanchor": "bottom", "yshift": 14 * level}
        labels.append({"text": name, "showarrow": False, "font": {"size": 11}, **position})
    return labels, len(ends)


def _thin_hidden(t: Array, y: Array, zoom: Zoom, points: int) -> tuple[Array, Array]:
    """Return times and values of a curve of about ``points``, most of them where it is seen."""
    if zoom is None or len(t) <= points:
        return thin(t, y, points)
    ends = np.searchsorted(t, zoom)
    start, stop = max(int(ends[0]) - 1, 0), min(int(ends[1]) + 1, len(t))
    # points are spent where they are seen, and a few on the rest, so that panning shows something
    parts = [(slice(0, start), MAX_HIDDEN_POINTS), (slice(start, stop), points), (slice(stop, None), MAX_HIDDEN_POINTS)]
    pieces = [thin(t[part], y[part], max_points) for part, max_points in parts if len(t[part])]
    times, values = zip(*pieces, strict=True)
    return np.concatenate(times), np.concatenate(values)


def _plain_line(x: Array, y: Array, name: str, colour: str, width: float = 1.0) -> Trace:
    line = {"color": colour, "width": width}
    return trace("scatter", x=x, y=y, name=name, mode="lines", line=line)


def _draw_over_time(
    figure: Drawing, t: Array, curves: Sequence[Curve], left_out: Sequence[tuple[float, float]], zoom: Zoom,
    points: int, of: str,
) -> Drawing:  # fmt: skip
    """Add curves over time, label the time axis, and draw the windows that are left out in grey."""
    start_time, rows = time_origin(t), max(row for row, *_ in curves)
    for row, name, values, colour, width in curves:
        x, y = _thin_hidden(t, values, zoom, points)
        line = curve(x - start_time, y, name, {"color": colour, "width": width}, len(x) + 8)
        figure.add(line | {"showlegend": row == 1}, row=row)
    last_axis = f"x{rows}"
    box = {"type": "rect", "xref": last_axis, "yref": "paper", "y0": 0, "y1": 1, "line": {"width": 0}, "layer": "below"}
    figure.layout["shapes"] = [
        {**box, "x0": start - start_time, "x1": stop - start_time, "fillcolor": LEFT_OUT_COLOUR}
        for start, stop in left_out
    ]
    title = f"time since {start_time:.0f} s, s" if start_time else TIME
    figure.layout[f"xaxis{rows}"]["title"] = {"text": title}
    figure.axes("y", exponentformat="power", nticks=6, automargin=False)  # margins that follow the labels take time
    figure.axes("x", automargin=False)
    figure.layout.update(margin={**MARGIN, "t": 30}, selectdirection="h", uirevision=of, font={"size": 12})
    return figure


def _vertical_line(at: float, colour: str = PALE) -> dict[str, Any]:
    line = {"color": colour, "width": 1.5, "dash": "dot"}
    return {"type": "line", "xref": "x", "yref": "y domain", "x0": at, "x1": at, "y0": 0, "y1": 1, "line": line}
