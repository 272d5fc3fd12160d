"""Figures of an identification over time, and its errors: torques, motions, free simulations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynident.errors import InputError, choices
from dynident.log import Log, Motion
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
    clock,
    curve,
    only,
    origin,
    panels,
    plain,
    trace,
)

if TYPE_CHECKING:
    from dynident.validation import FreeRun, LogValidation

__all__ = ["error_figure", "glance_figure", "motion_figure", "run_figure", "smoothing_figure", "torque_figure"]

HELD_OUT = (BLUE, GREEN, AMBER, RED)


def torque_figure(log: LogValidation, joint: str, unit: str = "N m", points: int = 2000) -> Drawing:
    """Draw a joint's measured and predicted torque over time, and their difference in a panel below.

    Samples outside the motion's mask are gaps; each curve is thinned to about ``points`` with its extremes kept.
    Raises InputError where the log has no such joint.
    """
    j = _column(log.motion, joint)
    measured = only(log.motion.tau[:, j], log.motion.mask)
    predicted = only(log.predicted[:, j], log.motion.mask)
    titles = [f"{'force' if unit == 'N' else 'torque'}, {unit}", f"residual, {unit}"]
    figure = panels(titles, 430, heights=[0.66, 0.34])
    curves = ("measured", measured, BLUE, 2.4, 1), ("predicted", predicted, RED, 1.2, 1)
    zero = origin(log.motion.t)
    for name, values, colour, width, row in (*curves, ("residual", measured - predicted, INK, 1.0, 2)):
        line = {"color": colour, "width": width}
        figure.add(curve(log.motion.t - zero, values, name, line, points), row=row)
    return _since(figure, zero)


def glance_figure(log: LogValidation, joint: str, unit: str = "N m", points: int = 1000) -> Drawing:
    """Draw a joint's measured and predicted torque over time in one small panel, as ``torque_figure`` does."""
    whole = torque_figure(log, joint, unit, points)
    figure = panels([whole.layout["yaxis"]["title"]["text"]], 220)
    for one in whole.data[:2]:
        figure.add(one)
    figure.layout["xaxis"]["title"] = whole.layout["xaxis2"]["title"]
    figure.layout["margin"] = {"t": 30, "b": 40}
    return figure


def motion_figure(
    motion: Motion,
    joint: str,
    unit: str = "rad",
    points: int = 2000,
    recorded: Log | None = None,
    time_offset: float = 0.0,
) -> Drawing:
    """Draw a joint's smoothed position, velocity and acceleration over time, one panel each.

    Samples outside the mask are gaps. Where the recording is given, its positions are drawn too, each ``time_offset``
    (s) before its stamp, and what the smoothing took away, measured minus smoothed, has a panel of its own. Raises
    InputError where the motion has no such joint.
    """
    j = _column(motion, joint)
    titles = [f"position, {unit}", f"velocity, {unit}/s", f"acceleration, {unit}/s²"]
    curves = {name: only(getattr(motion, name)[:, j], motion.mask) for name in ("q", "dq", "ddq")}
    zero = origin(motion.t)
    t = motion.t - zero
    if recorded is None:
        stacked = _stack(t, titles, curves, points)
        stacked.layout.update(showlegend=False, margin={"t": 15})
        return _since(stacked, zero)
    titles.insert(1, f"taken away, {unit}")
    figure = panels(titles, 700, heights=[0.28, 0.2, 0.24, 0.28])
    measured, smoothed = recorded.q[:, recorded.joints.index(joint)], motion.shifted(-time_offset)
    left = only(measured - smoothed.q[:, j], motion.mask & smoothed.mask)
    drawn = (
        (1, "measured", t - time_offset, only(measured, motion.mask), PALE, 3.5),
        (1, "smoothed", t, curves["q"], BLUE, 1.3),
        (2, "measured minus smoothed", t - time_offset, left, INK, 0.8),
        (3, "velocity", t, curves["dq"], GREEN, 1.3),
        (4, "acceleration", t, curves["ddq"], RED, 1.3),
    )
    for row, name, times, values, colour, width in drawn:
        line = {"color": colour, "width": width}
        figure.add(curve(times, values, name, line, points) | {"showlegend": row == 1}, row=row)
    return _since(figure, zero)


def run_figure(run: FreeRun, joint: str, unit: str = "rad", points: int = 2000) -> Drawing:
    """Draw a joint's measured and simulated position over time, and their difference below.

    A simulation that starts anew is broken at each start, and one that ran away is missing.
    Raises InputError where the run has no such joint.
    """
    if joint not in run.joints:
        raise InputError(f"{run.name}: no joint {joint!r}; {choices(joint, run.joints)}")
    j = run.joints.index(joint)
    simulated = only(run.q[:, j], np.isfinite(run.q[:, j]))
    if run.restart is not None:  # each piece begins at the measured state: its first sample is left out as a break
        simulated = only(simulated, run.q[:, j] != run.measured[:, j])
    figure = panels([f"position, {unit}", f"error, {unit}"], 430, heights=[0.66, 0.34])
    curves = ("measured", run.measured[:, j], BLUE, 2.4, 1), ("simulated", simulated, RED, 1.2, 1)
    zero = origin(run.t)
    for name, values, colour, width, row in (*curves, ("error", run.measured[:, j] - simulated, INK, 1.0, 2)):
        figure.add(curve(run.t - zero, values, name, {"color": colour, "width": width}, points), row=row)
    return _since(figure, zero)


def smoothing_figure(t: Array, measured: Array, smoothed: Sequence[Array], points: int = 4000) -> Drawing:
    """Draw smoothed values (N), the measured ones, and the two derivatives over time, one panel each."""
    curves = dict(zip(("smoothed", "first derivative", "second derivative"), smoothed, strict=True))
    figure = _stack(t, ["value", "first derivative", "second derivative"], curves, points)
    figure.add(curve(t, measured, "measured", {"color": INK, "width": 0.8}, points), row=1)
    return figure


def _stack(t: Array, titles: Sequence[str], curves: Mapping[str, Array], points: int) -> Drawing:
    figure = panels(titles, 480)
    for row, ((name, values), colour) in enumerate(zip(curves.items(), (BLUE, GREEN, RED), strict=True), start=1):
        figure.add(curve(t, values, name, {"color": colour, "width": 1.3}, points), row=row)
    return figure


def error_figure(logs: Sequence[LogValidation], joints: Sequence[str]) -> Drawing:
    """Draw the unfiltered relative error (%) by joint as bars, one for each log; training logs are grey."""
    height = 110 + len(joints) * (16 + 16 * len(logs))
    figure = panels([""], height, shared=False)
    held = [log.name for log in logs if log.role != "train"]
    for log in logs:
        train = log.role == "train"
        figure.add(
            trace(
                "bar",
                y=[plain(joint) for joint in joints],
                x=[log.errors.per_joint.get(joint) for joint in joints],
                orientation="h",
                name=f"{plain(log.name)} ({'training' if train else 'held out'})",
                marker={"color": PALE if train else HELD_OUT[held.index(log.name) % len(HELD_OUT)]},
                hovertemplate="%{y}: %{x:.3g} %",
            )
        )
    figure.axes("y", type="category", autorange="reversed", showgrid=False)
    figure.axes("x", title="torque error, %", rangemode="tozero")
    figure.layout.update(barmode="group", bargap=0.25, hovermode="closest")
    return figure


def _since(figure: Drawing, zero: float) -> Drawing:
    """Return the figure with its axis of time named after where it counts from."""
    for axis in figure.layout.values() if zero else ():
        if isinstance(axis, dict) and axis.get("title") == {"text": TIME}:
            axis["title"] = {"text": f"time since {clock(zero) or f'{zero:.0f} s'}, s"}
    return figure


def _column(motion: Motion, joint: str) -> int:
    if joint not in motion.joints:
        raise InputError(f"{motion.source}: no joint {joint!r}; {choices(joint, motion.joints)}")
    return motion.joints.index(joint)
