"""Figures of an identification: torques, motions and parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.errors import InputError, choices
from dynident.log import Motion
from dynident.plot.canvas import BLUE, GREEN, INK, RED, Array, curve, only, panels, plain

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from dynident.identify import Identification
    from dynident.validation import LogValidation

__all__ = ["motion_figure", "parameter_figure", "smoothing_figure", "torque_figure"]

NORMAL_95 = 1.96  # two-sided 95 % quantile of the normal distribution


def torque_figure(log: LogValidation, joint: str, unit: str = "N m", points: int = 2000) -> go.Figure:
    """Draw a joint's measured and predicted torque over time, and their difference in a panel below.

    Samples outside the motion's mask are gaps; each curve is thinned to about ``points`` with its extremes kept.
    Raises InputError where the log has no such joint.
    """
    j = _column(log.motion, joint)
    measured = only(log.motion.tau[:, j], log.motion.mask)
    predicted = only(log.predicted[:, j], log.motion.mask)
    figure = panels([f"{'force' if unit == 'N' else 'torque'}, {unit}", "residual"], 430, heights=[0.68, 0.32])
    curves = ("measured", measured, BLUE, 2.4, 1), ("predicted", predicted, RED, 1.2, 1)
    for name, values, colour, width, row in (*curves, ("residual", measured - predicted, INK, 1.0, 2)):
        line = {"color": colour, "width": width}
        figure.add_trace(curve(log.motion.t, values, name, line, points), row=row, col=1)
    return figure


def motion_figure(motion: Motion, joint: str, unit: str = "rad", points: int = 2000) -> go.Figure:
    """Draw a joint's smoothed position, velocity and acceleration over time, one panel each.

    Samples outside the mask are gaps. Raises InputError where the motion has no such joint.
    """
    j = _column(motion, joint)
    titles = [f"position, {unit}", f"velocity, {unit}/s", f"acceleration, {unit}/s²"]
    curves = {name: only(getattr(motion, name)[:, j], motion.mask) for name in ("q", "dq", "ddq")}
    return _stack(motion.t, titles, curves, points).update_layout(showlegend=False, margin={"t": 15})


def smoothing_figure(t: Array, measured: Array, smoothed: Sequence[Array], points: int = 4000) -> go.Figure:
    """Draw smoothed values (N), the measured ones, and the two derivatives over time, one panel each."""
    curves = dict(zip(("smoothed", "first derivative", "second derivative"), smoothed, strict=True))
    figure = _stack(t, ["value", "first derivative", "second derivative"], curves, points)
    figure.add_trace(curve(t, measured, "measured", {"color": INK, "width": 0.8}, points), row=1, col=1)
    return figure


def _stack(t: Array, titles: Sequence[str], curves: Mapping[str, Array], points: int) -> go.Figure:
    figure = panels(titles, 480)
    for row, ((name, values), colour) in enumerate(zip(curves.items(), (BLUE, GREEN, RED), strict=True), start=1):
        figure.add_trace(curve(t, values, name, {"color": colour, "width": 1.3}, points), row=row, col=1)
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
    figure = panels([""] * len(units), int(90 + 26 * sum(heights)), [plain(u) for u in units], heights, shared=False)
    for number, row in enumerate(rows, start=1):
        for trace in _forest(identification, row, legend=number == 1):
            figure.add_trace(trace, row=number, col=1)
    figure.update_yaxes(type="category", autorange="reversed", showgrid=False)
    figure.update_xaxes(title="")
    return figure.update_layout(hovermode="closest")


def _forest(identification: Identification, row: list[int], legend: bool) -> Iterable[Any]:
    import plotly.graph_objects as go

    estimate = identification.estimate
    names = [plain(estimate.names[i]) for i in row]
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
    true = {plain(parameter.name): parameter.value for parameter in identification.model.parameters}
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


def _column(motion: Motion, joint: str) -> int:
    if joint not in motion.joints:
        raise InputError(f"{motion.source}: no joint {joint!r}; {choices(joint, motion.joints)}")
    return motion.joints.index(joint)
