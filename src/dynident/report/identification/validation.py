"""How well an identified model does, in a report: errors, residuals, torques, free simulations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynident.models import Joint
from dynident.motion.splines import Rule, SmoothingSpline, smooth
from dynident.report.figures import Array
from dynident.report.identification.figures import error_figure, run_figure, smoothing_figure, torque_figure
from dynident.report.page import UNIT, Beside, Column, Figure, Fold, Head, PageBlock, PageSection, PageTable, render
from dynident.report.words import ROLES, figure_gallery, label_of, points
from dynident.runtime import ConfigError, InputError, Noun, join_names, number
from dynident.validation import FloorOrigin, residual_text

if TYPE_CHECKING:
    import polars as pl

    from dynident.files.tables import DataTable as Columns
    from dynident.identification import Identification
    from dynident.validation import LogValidation

MAX_FINE_RATIO = 1.5  # times the noise floor, up to which three digits are shown
_ERRORS = (
    "The relative error is the norm of measured minus predicted torque, in percent of the norm of the measured torque. "
    "Unfiltered is what the torque sensor saw; filtered is after the low-pass of the fit, where one was used. Over the "
    "noise floor: the unfiltered error divided by the noise of the sensors. The noise is the scatter between two "
    "passes of the same motion, if there are two. Otherwise it is estimated from white noise of torque and positions; "
    "coloured noise is not counted, so the figure is an upper bound (≤). It is not known (-) if the torque was "
    "filtered before it was recorded and no motion is repeated."
)
_RESIDUALS = (
    "Explained: one minus the variance left over that of the torque. Of the effort limit: the rmse, in % of what the "
    "robot file allows the joint. Independent after: the time after which samples of the residual count as new ones; "
    "where it is longer than one step, standard errors that assume independence are too small. White: the p-value of "
    "Ljung and Box; real residuals are hardly ever white. The last columns show where the residual is."
)
_RUNS = (
    "The model is simulated instead of the robot and its position compared with the measured one. In the loop of a "
    "controller, which keeps almost any model on its path, look at the commanded torque too."
)
_TORQUES = (
    "Measured and predicted torque, and below their difference. Drag over a part to zoom, double-click to return. "
    "Long curves are thinned such that every extreme stays."
)

_PREFIXES = ("", "d_", "dd_")  # of the names of values, first and second derivatives
_HEADS = {"sigma": "sigma", "noise": "noise left", "S": "S", "lam": "lam", "edf": "edf", "bandwidth": "bandwidth, s"}


def error_section(identification: Identification) -> PageSection:
    """Return the section of the errors: per log, per joint, and what is left of the torque."""
    joints = [joint.name for joint in identification.model.joints]
    figure = Figure(error_figure(identification.validations, joints), "Torque error by joint, unfiltered.")
    bars = (figure,) if len(joints) > 1 else ()
    blocks: list[PageBlock] = [_ERRORS, error_table(identification), *bars, _joint_matrix(identification)]
    if any(log.residuals for log in identification.validations):
        tests = _RESIDUALS, _residual_table(identification)
        blocks.append(Fold("What is left of the torque: tests of the residuals", tests))
    return PageSection("Errors", tuple(blocks))


def error_table(identification: Identification) -> PageTable:
    """Return the relative errors per log."""
    heads = ("samples", "unfiltered, %", "over the noise floor", "filtered, %")
    rows = []
    for log in identification.validations:
        unfiltered, filtered = (number(getattr(log.errors, f"relative_error{end}"), 3) for end in ("", "_filtered"))
        role = ROLES.get(log.role, log.role)
        rows.append((log.name, role, str(log.errors.samples), unfiltered, floor_ratio_text(log), filtered))
    return PageTable.of(("log", "role"), heads, rows, "Relative torque error per log")


def joint_table(identification: Identification) -> PageTable:
    """Return the errors with one row per log and joint, as a terminal shows them."""
    heads = ("error, %", "over the noise floor", "rmse", UNIT)
    rows = [
        (log.name, joint.name, *_joint_errors(log, joint.name), joint.effort)
        for log in identification.validations
        for joint in identification.model.joints
    ]
    return PageTable.of(("log", "joint"), heads, rows, "Torque error per log and joint, unfiltered")


def unknown_noise(identification: Identification) -> Iterator[str]:
    """Yield a sentence on the joints whose sensor noise is not known, and why."""
    known_joints = [{*log.errors.sensor_noise, *log.floors} for log in identification.validations if log.errors.rmse]
    names = [joint.name for joint in identification.model.joints]
    if unknown := [name for name in names if any(name not in known for known in known_joints)]:
        yield (
            f"The sensors' noise is not known of {join_names(unknown)}: the torque was filtered before it was "
            "recorded, or its noise is not white."
        )


def _joint_matrix(identification: Identification) -> PageTable:
    """Return the errors with one row per joint and the logs side by side."""
    heads: list[Head] = [UNIT]
    for log in identification.validations:
        heads += [(title, label_of(log)) for title in ("error, %", "over the noise floor", "rmse")]
        heads += [("of limit, %", label_of(log))] * bool(log.errors.effort_share)
    rows = []
    for joint in identification.model.joints:
        row = [joint.name, joint.effort]
        for log in identification.validations:
            row += _joint_errors(log, joint.name)
            row += [number(log.errors.effort_share.get(joint.name), 2)] * bool(log.errors.effort_share)
        rows.append(row)
    return PageTable.of(("joint",), heads, rows, "Torque error per joint, unfiltered")


def _joint_errors(log: LogValidation, joint: str) -> tuple[str, str, str]:
    error, rmse = (number(values.get(joint), 3) for values in (log.errors.per_joint, log.errors.rmse))
    return error, floor_ratio_text(log, joint), rmse


def floor_ratio_text(log: LogValidation, joint: str | None = None) -> str:
    """Return the error on a log over the noise floor, of a joint or of all; "≤ 1.8" where the floor is white noise."""
    floors = [floor for name, floor in log.floors.items() if joint in (None, name)]
    ratio = log.over_floor if joint is None else floors[0].ratio if floors else None
    white = any(floor.origin is FloorOrigin.WHITE for floor in floors)
    return f"{'≤ ' * white}{number(ratio, 3 if ratio is not None and ratio < MAX_FINE_RATIO else 2)}"


def _residual_table(identification: Identification) -> PageTable:
    heads = ("explained", "of the effort limit, %", "independent after, s", "white, p", "below 5 Hz, %", "peak, Hz")
    residual_heads = (*heads, "at reversals, %", Column("points to", numeric=False))
    rows = []
    for log in identification.validations:
        for joint, test in log.residuals.items():
            cells = [number(log.errors.r2.get(joint), 4), number(log.errors.effort_share.get(joint), 2)]
            cells += [number(value, 2) for value in (test.decorrelation, test.p_value, 100 * test.low_share)]
            cells += [number(test.peak, 3), number(100 * test.reversal_share, 2), residual_text(log, joint) or "-"]
            rows.append((log.name, joint, *cells))
    return PageTable.of(("log", "joint"), residual_heads, rows, "What is left of the torque, unfiltered")


def torque_section(identification: Identification, robot: Sequence[PageBlock] = ()) -> PageSection:
    """Return the section of the torques: one figure at a time, by log and joint.

    ``robot`` are words on the robot and, last, its view, which stands beside the figures.
    """
    curve_points = points(identification)

    def draw_torque(log: LogValidation, joint: Joint) -> Figure:
        error, _, rmse = _joint_errors(log, joint.name)
        drawing = torque_figure(log, joint.name, joint.effort, curve_points)
        return Figure(drawing, f"{joint.name}: relative error {error} %, rmse {rmse} {joint.effort}.")

    gallery = figure_gallery(identification, draw_torque)
    if not robot:
        return PageSection("Torques", (_TORQUES, *gallery))
    *notes, view = robot
    return PageSection("The robot and its torques", (_TORQUES, *notes, Beside((view,), gallery)))


def simulation_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section of the free simulations, where there are any."""
    if not identification.runs:
        return
    heads = ("position error, %", "of its way, %", "rms", "torque error, %")
    units = {joint.name: joint.unit for joint in identification.model.joints}
    rows = []
    for run in identification.runs:
        driver = run.driver if run.restart is None else f"{run.driver}, {run.restart:g} s"
        for joint in run.joints:
            errors = number(run.relative_error[joint], 3), number(run.motion_error[joint], 3)
            rms, torque_error = number(run.rms[joint], 3), number(run.torque_error.get(joint), 3)
            rows.append((run.name, driver, joint, *errors, f"{rms} {units[joint]}", torque_error))
    failures = tuple(f"{run.name}: {run.failure}" for run in identification.runs if run.failure)
    table = PageTable.of(("log", "driven by", "joint"), heads, rows, "Free simulation beside the measured position")
    runs, curve_points = {run.name: run for run in identification.runs if not run.failure}, points(identification)

    def draw_run(log: LogValidation, joint: Joint) -> Figure | None:
        run = runs.get(log.name)
        if run is None or joint.name not in run.joints:
            return None
        drawing = run_figure(run, joint.name, joint.unit, curve_points)
        return Figure(drawing, f"{joint.name}: measured and simulated position.")

    gallery = figure_gallery(identification, draw_run)
    yield PageSection("Free simulation", (_RUNS, *((failures,) if failures else ()), table, *gallery))


def prediction_table(logs: Sequence[LogValidation], joints: Sequence[Joint]) -> PageTable:
    """Return the errors per log and joint, for logs with measured torques."""
    rows: list[tuple[str, ...]] = []
    for log in logs:
        errors = log.errors
        rows.append((log.name, "all", number(errors.relative_error, 3), number(errors.all_over_noise, 2), "-", "-"))
        for name, unit in ((joint.name, joint.effort) for joint in joints):
            error, rmse = number(errors.per_joint[name], 3), number(errors.rmse[name], 3)
            rows.append((log.name, name, error, number(errors.over_noise.get(name), 2), rmse, unit))
    heads = ("error, %", "times white noise", "rmse", UNIT)
    return PageTable.of(("log", "joint"), heads, rows, "Torque error per log and joint, unfiltered")


def prediction_frame(logs: Sequence[tuple[LogValidation, bool]]) -> pl.DataFrame:
    """Return all logs as one table; each comes with whether its torques were measured.

    Columns: log, t (s), used (False where smoothing is not accurate, at the ends), and per joint measured_NAME
    (null without measurement) and predicted_NAME, in N m or N.
    """
    import polars as pl

    parts = []
    for log, measured in logs:
        motion = log.motion
        name = log.name.encode("utf-8", "backslashreplace").decode()  # a file's may be no text
        columns: dict[str, object] = {"log": [name] * len(motion), "t": motion.t, "used": motion.mask}
        for j, name in enumerate(motion.joints):
            torque = motion.tau[:, j] if measured else np.full(len(motion), np.nan)
            columns[f"measured_{name}"] = pl.Series(torque, nan_to_null=True)
            columns[f"predicted_{name}"] = log.predicted_torque[:, j]
        parts.append(pl.DataFrame(columns))
    return pl.concat(parts)


class SmoothedTable(Noun):
    """Columns of a file with their spline: ``names`` (k) of ``measured`` (N, k), over the column ``time``.

    ``stamps`` (N) are the values of that column, in its own unit; ``missing`` rows are left out, as they lack a number.
    """

    time: str
    stamps: Array
    names: tuple[str, ...]
    measured: Array
    fit: SmoothingSpline
    missing: int = 0

    def frame(self) -> pl.DataFrame:
        """Return a table of the time, the smoothed columns, and their first (d_) and second (dd_) derivatives."""
        import polars as pl

        columns = {self.time: self.stamps}
        for order, prefix in enumerate(_PREFIXES):
            values = self.fit.derivative(order)
            columns |= {f"{prefix}{name}": values[:, k] for k, name in enumerate(self.names)}
        return pl.DataFrame(columns)


def smooth_columns(
    table: Columns, time: str, unit: float, columns: Sequence[str], rule: Rule, sigma: float | None = None
) -> SmoothedTable:
    """Smooth ``columns`` of a table, by default all but the ``time``; ``sigma`` in their unit, None: estimated.

    Derivatives are per s; ``unit`` (s) is that of the stamps.

    Raises InputError for columns that are missing, differ in length or cannot be smoothed, ConfigError where a column
    has the name of another one's derivative.
    """
    stamps = table.column(time)
    names = tuple(columns) or tuple(name for name, x in table.columns.items() if name != time and np.isfinite(x).any())
    if not names:
        raise InputError(f"{table.source}: holds no column of numbers besides {time!r} to smooth.")
    derivatives = [f"{prefix}{name}" for prefix in _PREFIXES[1:] for name in names]
    if clash := next((name for name in derivatives if name in (*names, time)), None):
        raise ConfigError(f"{table.source}: {clash!r} would name both a column and a derivative; choose with --column.")
    if wrong := [name for name in names if len(table.column(name)) != len(stamps)]:
        raise InputError(f"{table.source}: column {wrong[0]!r} and {time!r} differ in length.")
    measured = np.column_stack([table.column(name) for name in names])
    if not (has_number := np.isfinite(measured).any(axis=0)).all():
        empty = names[int(has_number.argmin())]
        raise InputError(f"{table.source}: column {empty!r} holds no number; choose others with --column.")
    keep = np.isfinite(measured).all(axis=1) & np.isfinite(stamps)
    stamps, measured = stamps[keep], measured[keep]
    try:
        fit = smooth(unit * stamps, measured, rule, sigma=sigma, names=[f"column {name!r}" for name in names])
    except InputError as error:
        raise InputError(f"{table.source}: {error}") from error
    return SmoothedTable(time, stamps, names, measured, fit, int((~keep).sum()))


def smoothing_table(names: Sequence[str], fit: SmoothingSpline) -> PageTable:
    """Return the smoothing of each column: noise, S, lam, effective degrees of freedom, bandwidth."""
    values = [np.atleast_1d(getattr(fit, key)) for key in _HEADS]
    rows = ((name, *(number(float(value[k])) for value in values)) for k, name in enumerate(names))
    return PageTable.of(("column",), _HEADS.values(), rows, "Smoothing per column")


def smoothing_page(source: str, names: Sequence[str], measured: np.ndarray, fit: SmoothingSpline) -> str:
    """Return the page: the table, and per column the measured and smoothed values with both derivatives."""
    parts = [fit.derivative(order) for order in range(3)]
    sections = [PageSection("Smoothing", (smoothing_table(names, fit),))]
    for k, name in enumerate(names):
        figure = smoothing_figure(fit.t, measured[:, k], [part[:, k] for part in parts])
        sections.append(PageSection(name, (Figure(figure, name),)))
    return render(f"Smoothed {source}", "Natural cubic smoothing splines and their derivatives.", sections)
