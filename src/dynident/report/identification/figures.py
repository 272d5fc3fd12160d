"""Figures of parameters: their intervals, and the singular values that tell how many of them the data show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Pieces
from dynident.identification.terms import TermTrial, TrialOutcome
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.motion.splines import NORMAL_95
from dynident.regression import BaseParameters
from dynident.report.figures import (
    AMBER,
    BLUE,
    GREEN,
    GRID,
    INK,
    PALE,
    RED,
    TIME,
    Array,
    Drawing,
    Trace,
    clock,
    curve,
    panels,
    plain,
    time_origin,
    trace,
    with_gaps,
)
from dynident.runtime import InputError, choices
from dynident.validation import FreeRun, LogValidation

HELD_OUT_COLOURS = (BLUE, GREEN, AMBER, RED)
JOINT_COLOURS = (BLUE, RED, GREEN, AMBER, INK, PALE)
HOUR, MIN_HOURS_AXIS = 3600.0, 7200.0  # s

OUTCOME_COLOURS = {
    TrialOutcome.ENTERED: GREEN, TrialOutcome.TOO_SMALL: INK, TrialOutcome.WITHIN_ERROR: AMBER,
    TrialOutcome.NOT_EXCITED: INK, TrialOutcome.KEPT: GREEN,
}  # fmt: skip
# %, between which the axis ends; and its lower end, relative to the upper one
MIN_UPPER_END, MAX_UPPER_END, MAX_LOWER_RATIO = 5.0, 105.0, 0.6

MAX_AXIS_PERCENT = 100.0  # % of a parameter's value at which the axis ends
MIN_SINGULAR_VALUE = 1e-20  # relative singular values below it are zero but for rounding
MAX_NAME_LENGTH = 30  # letters of a name at the axis; the rest shows when pointed at


def torque_figure(log: LogValidation, joint: str, unit: str = "N m", points: int = 2000) -> Drawing:
    """Draw a joint's measured and predicted torque over time, and their difference in a panel below.

    Samples outside the motion's mask are gaps; each curve is thinned to about ``points`` with its extremes kept.
    Raises InputError where the log has no such joint.
    """
    j = _joint_index(log.motion, joint)
    measured = with_gaps(log.motion.tau[:, j], log.motion.mask)
    predicted = with_gaps(log.predicted_torque[:, j], log.motion.mask)
    titles = [f"{'force' if unit == 'N' else 'torque'}, {unit}", f"residual, {unit}"]
    return _draw_difference(
        log.motion.t, titles, measured, {"predicted": predicted, "residual": measured - predicted}, points
    )


def _draw_difference(
    t: Array, titles: Sequence[str], measured: Array, others: Mapping[str, Array], points: int
) -> Drawing:
    """Draw what is measured and what a model says over time t (N), and their difference below."""
    figure = panels(titles, 430, heights=[0.66, 0.34])
    zero, lines = time_origin(t), ((BLUE, 2.4, 1), (RED, 1.2, 1), (INK, 1.0, 2))
    for (name, values), (colour, width, row) in zip({"measured": measured, **others}.items(), lines, strict=True):
        figure.add(curve(t - zero, values, name, {"color": colour, "width": width}, points), row=row)
    return _label_time_axis(figure, zero)


def glance_figure(log: LogValidation, joint: str, unit: str = "N m") -> Drawing:
    """Draw a joint's measured and predicted torque over time in one small panel, as ``torque_figure`` does."""
    full = torque_figure(log, joint, unit, 1000)
    figure = panels([full.layout["yaxis"]["title"]["text"]], 220)
    for line in full.data[:2]:
        figure.add(line)
    figure.layout["xaxis"]["title"] = full.layout["xaxis2"]["title"]
    figure.layout["margin"] = {"t": 30, "b": 40}
    return figure


def motion_figure(
    motion: Motion, joint: str, unit: str = "rad", points: int = 2000, recorded: Log | None = None
) -> Drawing:
    """Draw a joint's smoothed position, velocity and acceleration over time, one panel each.

    Samples outside the mask are gaps. Where the recording is given, its positions are drawn too, each by the motion's
    time offset before its stamp, and what the smoothing took away, measured minus smoothed, has a panel of its own.
    Raises InputError where the motion has no such joint.
    """
    j = _joint_index(motion, joint)
    titles = [f"position, {unit}", f"velocity, {unit}/s", f"acceleration, {unit}/s²"]
    curves = {name: with_gaps(getattr(motion, name)[:, j], motion.mask) for name in ("q", "dq", "ddq")}
    zero, time_offset = time_origin(motion.t), motion.time_offset
    t = motion.t - zero
    if recorded is None:
        stacked = _stack_panels(t, titles, curves, points)
        stacked.layout.update(showlegend=False, margin={"t": 15})
        return _label_time_axis(stacked, zero)
    titles.insert(1, f"taken away, {unit}")
    figure = panels(titles, 700, heights=[0.28, 0.2, 0.24, 0.28])
    # Undo the time offset, so that both are taken at the stamps of the recording
    measured, smoothed = recorded.q[:, recorded.joints.index(joint)], motion.shift(-time_offset)
    removed = with_gaps(measured - smoothed.q[:, j], motion.mask & smoothed.mask)
    curve_rows = (
        (1, "measured", t - time_offset, with_gaps(measured, motion.mask), PALE, 3.5),
        (1, "smoothed", t, curves["q"], BLUE, 1.3),
        (2, "measured minus smoothed", t - time_offset, removed, INK, 0.8),
        (3, "velocity", t, curves["dq"], GREEN, 1.3),
        (4, "acceleration", t, curves["ddq"], RED, 1.3),
    )
    for row, name, times, values, colour, width in curve_rows:
        line = {"color": colour, "width": width}
        figure.add(curve(times, values, name, line, points) | {"showlegend": row == 1}, row=row)
    return _label_time_axis(figure, zero)


def run_figure(run: FreeRun, joint: str, unit: str = "rad", points: int = 2000) -> Drawing:
    """Draw a joint's measured and simulated position over time, and their difference below.

    A simulation that starts anew is broken at each start, and one that ran away is missing.
    Raises InputError where the run has no such joint.
    """
    if joint not in run.joints:
        raise InputError(f"{run.name}: no joint {joint!r}; {choices(joint, run.joints)}")
    j = run.joints.index(joint)
    simulated = with_gaps(run.q[:, j], np.isfinite(run.q[:, j]))
    if run.restart is not None:  # each piece begins at the measured state: its first sample is left out as a break
        simulated = with_gaps(simulated, run.q[:, j] != run.measured[:, j])
    titles, measured = [f"position, {unit}", f"error, {unit}"], run.measured[:, j]
    return _draw_difference(run.t, titles, measured, {"simulated": simulated, "error": measured - simulated}, points)


def smoothing_figure(t: Array, measured: Array, smoothed: Sequence[Array], points: int = 4000) -> Drawing:
    """Draw smoothed values (N), the measured ones, and the two derivatives over time, one panel each."""
    curves = dict(zip(("smoothed", "first derivative", "second derivative"), smoothed, strict=True))
    figure = _stack_panels(t, ["value", "per s", "per s²"], curves, points)
    figure.add(curve(t, measured, "measured", {"color": INK, "width": 0.8}, points), row=1)
    return figure


def _stack_panels(t: Array, titles: Sequence[str], curves: Mapping[str, Array], points: int) -> Drawing:
    figure = panels(titles, 480)
    for row, ((name, values), colour) in enumerate(zip(curves.items(), (BLUE, GREEN, RED), strict=True), start=1):
        figure.add(curve(t, values, name, {"color": colour, "width": 1.3}, points), row=row)
    return figure


def error_figure(logs: Sequence[LogValidation], joints: Sequence[str]) -> Drawing:
    """Draw the unfiltered relative error (%) by joint as bars, one for each log; training logs are grey."""
    height = 110 + len(joints) * (16 + 16 * len(logs))
    figure = panels([""], height, shared=False)
    held_out = [log.name for log in logs if log.role != "train"]
    y = [plain(joint) for joint in joints]
    for log in logs:
        role, colour = "training", PALE
        if log.role != "train":
            role, colour = "held out", HELD_OUT_COLOURS[held_out.index(log.name) % len(HELD_OUT_COLOURS)]
        look = {"orientation": "h", "name": f"{plain(log.name)} ({role})", "marker": {"color": colour}}
        x = [log.errors.per_joint.get(joint) for joint in joints]
        figure.add(trace("bar", y=y, x=x, **look, hovertemplate="%{y}: %{x:.3g} %"))
    figure.axes("y", type="category", autorange="reversed", showgrid=False)
    figure.axes("x", title="torque error, %", rangemode="tozero")
    figure.layout.update(barmode="group", bargap=0.25, hovermode="closest")
    return figure


def _label_time_axis(figure: Drawing, zero: float) -> Drawing:
    """Return the figure with its time axis labelled by where it counts from."""
    for axis in figure.layout.values() if zero else ():
        if isinstance(axis, dict) and axis.get("title") == {"text": TIME}:
            axis["title"] = {"text": f"time since {clock(zero) or f'{zero:.0f} s'}, s"}
    return figure


def _joint_index(motion: Motion, joint: str) -> int:
    if joint not in motion.joints:
        raise InputError(f"{motion.source}: no joint {joint!r}; {choices(joint, motion.joints)}")
    return motion.joints.index(joint)


def pieces_figure(pieces: Pieces, joints: Sequence[str]) -> Drawing:
    """Draw the residual of each joint, relative to its torque over all pieces (%), over the time of the pieces.

    A piece without rows of a joint is a gap. Recordings follow each other; each begins at its own time.
    """
    middle = (pieces.begins + pieces.ends) / 2
    long = float(np.ptp(middle)) > MIN_HOURS_AXIS
    t = (middle - pieces.begins.min()) / (HOUR if long else 1.0)
    # Relative to the torque over all pieces, so that a piece at rest does not stand out
    torque_rms = np.sqrt((pieces.rows * pieces.torque**2).sum(axis=0) / np.maximum(pieces.rows.sum(axis=0), 1))
    figure = panels(["residual of the torque, %"], 360)
    for j, joint in enumerate(joints):
        if torque_rms[j] == 0:
            continue
        share = np.where(pieces.rows[:, j] > 0, 100.0 * pieces.residual[:, j] / torque_rms[j], np.nan)
        for k, name in enumerate(dict.fromkeys(pieces.recording)):
            indices = np.flatnonzero(np.array(pieces.recording) == name)
            several = len(set(pieces.recording)) > 1
            line = {"color": JOINT_COLOURS[j % len(JOINT_COLOURS)], "width": 1.3}
            curve = trace("scatter", x=t[indices], y=share[indices], mode="lines", line=line, legendgroup=plain(joint))
            words = f"{plain(joint)}, {plain(name)}" if several else plain(joint)
            figure.add(curve | {"name": words, "showlegend": k == 0 or several})
    figure.axes("x", title="time, h" if long else "time, s")
    figure.axes("y", rangemode="tozero")
    return figure


def trial_figure(trials: Sequence[TermTrial], words: Mapping[TrialOutcome, str]) -> Drawing:
    """Draw the gain of each trial with its standard error, one row each, coloured by its outcome in ``words``.

    A diamond is the gain on faster motion. The axis shows the gains; what is far below zero leaves it.
    """
    rows = {trial.kind: k for k, trial in enumerate(trials)}
    figure = panels([""], 110 + 24 * len(trials), shared=False)
    for outcome in dict.fromkeys(trial.outcome for trial in trials):
        outcome_trials = [trial for trial in trials if trial.outcome is outcome]
        figure.add(_gain_marks(outcome_trials, [rows[trial.kind] for trial in outcome_trials], outcome, words[outcome]))
    if fast := [trial for trial in trials if trial.faster is not None]:
        figure.add(_faster_marks(fast, [rows[trial.kind] for trial in fast]))
    ends = [(x.gain, x.std) for x in trials] + [(x.faster or 0.0, x.faster_std or 0.0) for x in fast]
    finite = [end for end in ends if np.isfinite(end).all()]
    # The axis ends beyond the largest gain with its error, within fixed bounds; far negative gains may leave it
    upper = min(max(1.08 * max((gain + std for gain, std in finite), default=0.0), MIN_UPPER_END), MAX_UPPER_END)
    lower = min((gain - std for gain, std in finite), default=0.0)
    figure.axes("x", title="gain, % of the squared cross-validated error", zeroline=True, zerolinecolor=GRID)
    figure.axes("x", range=[max(1.08 * min(lower, 0.0), -MAX_LOWER_RATIO * upper) - 0.02 * upper, upper])
    figure.axes("y", tickvals=list(rows.values()), ticktext=[plain(kind) for kind in rows])
    figure.axes("y", range=[len(trials) - 0.5, -0.5])
    figure.layout.update(hovermode="closest", showlegend=True)
    return figure


def _gain_marks(trials: Sequence[TermTrial], rows: Sequence[int], outcome: TrialOutcome, words: str) -> Trace:
    colour = OUTCOME_COLOURS.get(outcome, RED)
    marker = {"color": colour, "size": 9, "symbol": "circle" if outcome is TrialOutcome.ENTERED else "circle-open"}
    error = {"array": np.array([trial.std for trial in trials]), "color": colour, "thickness": 1.6, "width": 4}
    text = [f"{plain(trial.kind)}: {trial.gain:.3g} ± {trial.std:.2g} %, {words}" for trial in trials]
    return _marks(np.array([trial.gain for trial in trials]), list(rows), words, marker, text=text, error_x=error)


def _faster_marks(trials: Sequence[TermTrial], rows: Sequence[int]) -> Trace:
    gain, std = np.array([(trial.faster, trial.faster_std) for trial in trials], dtype=float).T
    pairs = zip(trials, std, strict=True)
    text = [f"{plain(trial.kind)} on faster motion: {trial.faster:.3g} ± {error:.2g} %" for trial, error in pairs]
    marker = {"color": BLUE, "size": 6, "symbol": "diamond-open"}
    error_bar = {"array": std, "color": BLUE, "thickness": 1, "width": 3}
    return _marks(gain, np.array(rows) + 0.28, "on faster motion", marker, text=text, error_x=error_bar)


def _marks(
    x: NDArray[Any], y: Sequence[int] | Array, name: str, marker: dict[str, Any], hover: str = "%{text}", **more: Any
) -> Trace:
    """Return marks without a line."""
    hover += "<extra></extra>"
    return trace("scatter", x=x, y=y, mode="markers", name=name, marker=marker, hovertemplate=hover, **more)


def interval_figure(
    names: Sequence[str], units: Sequence[str], value: Array, std: Array, true_values: Sequence[float | None] = ()
) -> Drawing:
    """Draw the 95 % interval (1.96 standard errors) of each parameter (k) in % of its value, one row per parameter.

    The axis ends at 100 %: a bar that leaves it means that not even the sign is known. Parameters that the data
    do not determine (infinite standard error, or a value of zero) are hollow and have no bar; a blue cross is the
    distance of the value in ``true_values``, where there is one, in % of the estimate.
    """
    rows = list(range(len(names)))
    value, std = np.asarray(value, dtype=float), np.asarray(std, dtype=float)
    relative = relative_std(value, std)
    is_determined = np.isfinite(relative)
    # Bars far beyond the axis are capped
    half = np.where(is_determined, np.minimum(NORMAL_95 * relative, 1e6), 0.0)
    signs = zip(names, value, std, units, strict=True)
    words = [f"{plain(name)}: {v:.4g} ± {NORMAL_95 * s:.2g} {plain(unit)}" for name, v, s, unit in signs]
    figure = panels([""], 105 + 20 * len(names), shared=False)
    figure.add(_intervals(words, half, is_determined))
    known_rows = [k for k, true in enumerate(true_values) if true is not None and is_determined[k]]
    if known_rows:
        true = np.array([true_values[k] for k in known_rows], dtype=float)
        distance = 100 * (true - value[known_rows]) / np.abs(value[known_rows])
        figure.add(_crosses([plain(names[k]) for k in known_rows], true, distance, known_rows))
    reach = float(np.clip(1.2 * half.max(initial=0.0), 0.01, MAX_AXIS_PERCENT))
    labels = [plain(name if len(name) <= MAX_NAME_LENGTH else f"{name[:MAX_NAME_LENGTH]}…") for name in names]
    figure.axes("y", tickvals=rows, ticktext=labels, range=[len(names) - 0.5, -0.5])
    figure.axes("x", range=[-reach, reach], title="95 % interval, % of the value", zeroline=True, zerolinecolor=GRID)
    figure.layout.update(hovermode="closest", showlegend=True)
    return figure


def _intervals(words: Sequence[str], half: Array, is_determined: NDArray[np.bool_]) -> Trace:
    """Return a mark per parameter (k) with its interval to both sides (%), hollow where not ``is_determined``."""
    name = "estimate with its 95 % interval" + ("" if is_determined.all() else " (hollow: not determined, or zero)")
    marker = {"color": RED, "size": 8, "symbol": ["circle" if ok else "circle-open" for ok in is_determined]}
    error, hover = {"array": half, "color": RED, "thickness": 1.6, "width": 4}, "%{text} (95 % interval)"
    return _marks(np.zeros(len(words)), list(range(len(words))), name, marker, hover, text=words, error_x=error)


def _crosses(names: Sequence[str], true: Array, distance: Array, rows: Sequence[int]) -> Trace:
    """Return a cross per known parameter, at its ``distance`` (%) from the estimate."""
    marker = {"color": BLUE, "size": 11, "symbol": "x-thin", "line": {"color": BLUE, "width": 2}}
    hover = "%{text}: true value %{customdata:.4g}"
    return _marks(distance, rows, "true value", marker, hover, text=names, customdata=true)


def relative_std(value: Array, std: Array) -> Array:
    """Return the standard errors (p) in % of the values; infinite where the value is zero."""
    value, std = np.asarray(value), np.asarray(std)
    relative: Array = np.full(len(value), np.inf)
    with np.errstate(over="ignore"):
        np.divide(100 * std, np.abs(value), out=relative, where=value != 0)
    return relative


def has_nominal_values(model: Model) -> bool:
    """Tell whether the known values are only nominal, as in a model from a robot file, which has bodies."""
    return any(parameter.body for parameter in model.parameters)


def singular_figure(basis: BaseParameters) -> Drawing:
    """Draw the singular values of the column-scaled regressor, largest first; those beyond the rank are hollow."""
    values = np.asarray(basis.singular_values, dtype=float)
    figure = panels(["singular value, relative"], 300, shared=False)
    order, relative = np.arange(1, len(values) + 1), values / (values[:1] if values[0] > 0 else 1.0)
    for name, rows, colour, symbol in (
        ("seen by the data", order <= basis.rank, BLUE, "circle"),
        ("not seen", order > basis.rank, INK, "circle-open"),
    ):
        # Zero cannot be drawn on a logarithmic axis
        rows = rows & (relative > MIN_SINGULAR_VALUE)
        if rows.any():
            marker = {"color": colour, "size": 6, "symbol": symbol}
            figure.add(_marks(order[rows], relative[rows], name, marker, "number %{x}: %{y:.2g}"))
    figure.axes("y", type="log", exponentformat="power", nticks=8, tickfont={"size": 11})
    figure.axes("x", title="number of the singular value")
    figure.layout.update(hovermode="closest")
    return figure
