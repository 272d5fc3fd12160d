"""Figures of an identification: torques, motions and parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.errors import InputError, choices
from dynident.log import Motion
from dynident.plot.canvas import BLUE, GREEN, GRID, INK, RED, Array, curve, only, panels, plain

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from dynident.estimators import Estimate
    from dynident.identify import Identification
    from dynident.model import Model
    from dynident.validation import LogValidation

__all__ = [
    "motion_figure",
    "parameter_figure",
    "reference_word",
    "relative_std",
    "smoothing_figure",
    "torque_figure",
]

WIDEST = 100.0  # % of a parameter's value at which the axis ends
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
    """Draw the 95 % interval (1.96 standard errors) of each parameter in % of its value, one row per parameter.

    The axis ends at 100 %: a bar that leaves it means that not even the sign is known. Parameters that the data do not
    determine (infinite standard error, or a value of zero) are hollow and have no bar; a blue cross is the distance
    of the true value, where the model knows it, in % of the estimate.
    """
    figure = panels([""], 110 + 20 * len(identification.estimate.names), shared=False)
    for trace in _errors(identification):
        figure.add_trace(trace, row=1, col=1)
    last = len(identification.estimate.names) - 0.5
    half = NORMAL_95 * relative_std(identification.estimate)
    reach = float(np.clip(1.2 * half[np.isfinite(half)].max(initial=0.0), 0.01, WIDEST))
    figure.update_yaxes(type="category", range=[last, -0.5], dtick=1)
    figure.update_xaxes(range=[-reach, reach], title="95 % interval, % of the value", zeroline=True, zerolinecolor=GRID)
    return figure.update_layout(hovermode="closest")


def relative_std(estimate: Estimate) -> Array:
    """Return the standard errors (p) in % of the values; infinite where the value is zero."""
    value, std = np.asarray(estimate.value), np.asarray(estimate.std)
    relative: Array = np.full(len(value), np.inf)
    with np.errstate(over="ignore"):
        np.divide(100 * std, np.abs(value), out=relative, where=value != 0)
    return relative


def reference_word(model: Model) -> str:
    """Return what the parameters' known values are: "nominal" from a robot file, which knows bodies, else "true"."""
    return "nominal" if any(parameter.body for parameter in model.parameters) else "true"


def _errors(identification: Identification) -> Iterable[Any]:
    import plotly.graph_objects as go

    estimate, model = identification.estimate, identification.model
    names = [plain(name) for name in estimate.names]
    relative = relative_std(estimate)
    sure = np.isfinite(relative)
    half = np.where(sure, np.minimum(NORMAL_95 * relative, 1e6), 0.0)
    signs = zip(estimate.value, estimate.std, estimate.units, strict=True)
    yield go.Scatter(
        x=np.zeros(len(names)),
        y=names,
        error_x={"array": half, "color": RED, "thickness": 1.6, "width": 4},
        mode="markers",
        name="estimate with its 95 % interval (hollow: not determined)",
        marker={"color": RED, "size": 8, "symbol": ["circle" if ok else "circle-open" for ok in sure]},
        text=[f"{value:.4g} ± {NORMAL_95 * std:.2g} {plain(unit)}" for value, std, unit in signs],
        hovertemplate="%{y}: %{text} (95 % interval)<extra></extra>",
    )
    known = [k for k, parameter in enumerate(model.parameters) if parameter.value is not None and sure[k]]
    if known and reference_word(model) == "true":
        true = np.array([model.parameters[k].value for k in known], dtype=float)
        value = np.asarray(estimate.value)[known]
        yield go.Scatter(
            x=100 * (true - value) / np.abs(value),
            y=[names[k] for k in known],
            mode="markers",
            name="true value",
            marker={"color": BLUE, "size": 11, "symbol": "x-thin", "line": {"color": BLUE, "width": 2}},
            customdata=true,
            hovertemplate="%{y}: true value %{customdata:.4g}<extra></extra>",
        )


def _column(motion: Motion, joint: str) -> int:
    if joint not in motion.joints:
        raise InputError(f"{motion.source}: no joint {joint!r}; {choices(joint, motion.joints)}")
    return motion.joints.index(joint)
