"""How well an identified model does, in a report: errors, what is left of the torque, torques, free simulations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from dynident.report import figures
from dynident.report.page import UNIT, Beside, Column, Figure, Fold, Gallery, PageBlock, PageSection, PageTable, number
from dynident.report.wording import residual_words, words
from dynident.report.words import ROLES, labelled, listed, points
from dynident.validation import FloorOrigin

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.validation import LogValidation

__all__ = ["error_section", "error_table", "joint_table", "over_floor", "simulation_section",
           "torque_section", "unknown_noise"]  # fmt: skip

NEAR = 1.5  # times the noise floor, up to which three digits are shown
_ERRORS = (
    "The relative error is the norm of measured minus predicted torque, in percent of the norm of the measured torque. "
    "Unfiltered is what the torque sensor saw; filtered is after the low-pass of the fit, where one was used. Over the "
    "noise floor: the unfiltered error over what the sensors allow of any model. That is the scatter between two "
    "passes of the same motion, where there are two; else the least that white noise of torque and positions leaves, "
    "of which coloured noise is not part, so that the figure is the most it can be (≤). It is not known (-) where the "
    "torque was filtered before it was recorded, and no motion is repeated."
)
_RESIDUALS = (
    "Explained: one minus the variance left over that of the torque. Of the effort limit: the rmse, in % of what the "
    "robot file allows the joint. Independent after: the time after which samples of the residual count as new ones; "
    "where it is longer than one step, standard errors that assume independence are too small. White: the p-value of "
    "Ljung and Box; real residuals are hardly ever white. The last columns show where the residual is."
)
_RUNS = (
    "The model is simulated instead of the robot and its position compared with the measured one. In the loop of a "
    "controller, which holds almost any model on its way, look at the torque it asks for too."
)
_TORQUES = (
    "Measured and predicted torque, and below their difference. Drag over a part to zoom, double-click to return. "
    "Long curves are thinned such that every extreme stays."
)


def error_section(identification: Identification) -> PageSection:
    """Return the section of the errors: per log, per joint, and what is left of the torque."""
    joints = [joint.name for joint in identification.model.joints]
    figure = Figure(figures.error_figure(identification.validations, joints), "Torque error by joint, unfiltered.")
    bars = (figure,) if len(joints) > 1 else ()
    blocks: list[PageBlock] = [_ERRORS, error_table(identification), *bars, _matrix(identification)]
    if any(log.residuals for log in identification.validations):
        blocks.append(Fold("What is left of the torque: tests of the residuals", (_RESIDUALS, _left(identification))))
    return PageSection("Errors", tuple(blocks))


def error_table(identification: Identification) -> PageTable:
    """Return the relative errors per log."""
    words = (Column("log", numeric=False), Column("role", numeric=False))
    heads = ("samples", "unfiltered, %", "over the noise floor", "filtered, %")
    columns = (*words, *map(Column, heads))
    rows = [
        (
            log.name,
            ROLES.get(log.role, log.role),
            str(log.errors.samples),
            number(log.errors.relative_error, 3),
            over_floor(log),
            number(log.errors.relative_error_filtered, 3),
        )
        for log in identification.validations
    ]
    return PageTable(columns, tuple(rows), "Relative torque error per log")


def joint_table(identification: Identification) -> PageTable:
    """Return the errors with one row per log and joint, as a terminal shows them."""
    names = (Column("log", numeric=False), Column("joint", numeric=False))
    columns = (*names, *map(Column, ("error, %", "over the noise floor", "rmse")))
    rows = [
        (log.name, joint.name, *_joint_errors(log, joint.name), joint.effort)
        for log in identification.validations
        for joint in identification.model.joints
    ]
    return PageTable((*columns, UNIT), tuple(rows), "Torque error per log and joint, unfiltered")


def unknown_noise(identification: Identification) -> Iterator[str]:
    """Yield of which joints it is not known how far the error is above the sensors' noise, and why, as a sentence."""
    known = [{*log.errors.sensor_noise, *log.floors} for log in identification.validations if log.errors.rmse]
    unknown = [one.name for one in identification.model.joints if any(one.name not in names for names in known)]
    if unknown:
        yield (
            f"The sensors' noise is not known of {listed(unknown)}: the torque was filtered before it was recorded, or "
            "its noise is not white."
        )


def _matrix(identification: Identification) -> PageTable:
    """Return the errors with one row per joint and the logs side by side."""
    heads = [Column("joint", numeric=False), UNIT]
    for log in identification.validations:
        name = f"{log.name} ({ROLES.get(log.role, log.role)})"
        heads += [Column(title, name) for title in ("error, %", "over the noise floor", "rmse")]
        heads += [Column("of limit, %", name)] * bool(log.errors.effort_share)
    rows = []
    for joint in identification.model.joints:
        row = [joint.name, joint.effort]
        for log in identification.validations:
            row += _joint_errors(log, joint.name)
            row += [number(log.errors.effort_share.get(joint.name), 2)] * bool(log.errors.effort_share)
        rows.append(tuple(row))
    return PageTable(tuple(heads), tuple(rows), "Torque error per joint, unfiltered")


def _joint_errors(log: LogValidation, joint: str) -> tuple[str, str, str]:
    errors = log.errors
    return (
        number(errors.per_joint.get(joint), 3),
        over_floor(log, joint),
        number(errors.rmse.get(joint), 3),
    )


def over_floor(log: LogValidation, joint: str | None = None) -> str:
    """Return how many times the noise floor the error on a log is, of a joint or of all: "≤ 1.8" by white noise."""
    chosen = [one for name, one in log.floors.items() if joint in (None, name)]
    ratio = log.over_floor if joint is None else chosen[0].ratio if chosen else None
    white = any(one.origin is FloorOrigin.WHITE for one in chosen)
    return f"{'≤ ' * white}{number(ratio, 3 if ratio is not None and ratio < NEAR else 2)}"


def _left(identification: Identification) -> PageTable:
    heads = ("explained", "of the effort limit, %", "independent after, s", "white, p", "below 5 Hz, %", "peak, Hz")
    columns = (Column("log", numeric=False), Column("joint", numeric=False), *map(Column, heads))
    rows = [
        (
            log.name,
            joint,
            number(log.errors.r2.get(joint), 4),
            number(log.errors.effort_share.get(joint), 2),
            number(test.decorrelation, 2),
            number(test.p_value, 2),
            number(100 * test.low_share, 2),
            number(test.peak, 3),
            number(100 * test.reversal_share, 2),
            residual_words(log, joint) or "-",
        )
        for log in identification.validations
        for joint, test in log.residuals.items()
    ]
    more = (Column("at reversals, %"), Column("points to", numeric=False))
    return PageTable((*columns, *more), tuple(rows), "What is left of the torque, unfiltered")


def torque_section(identification: Identification, robot: Sequence[PageBlock] = ()) -> PageSection:
    """Return the section of the torques: one figure at a time, by log and joint, beside the ``robot``, if it is given
    as words and a view of it."""
    fine = points(identification)
    views = []
    for label, k in labelled(identification):
        log = identification.validations[k]
        for joint in identification.model.joints:
            caption = (
                f"{joint.name}: relative error {number(log.errors.per_joint.get(joint.name), 3)} %, "
                f"rmse {number(log.errors.rmse.get(joint.name), 3)} {joint.effort}."
            )
            figure = figures.torque_figure(log, joint.name, joint.effort, fine).of(label)
            views.append(((label, joint.name), (Figure(figure, caption),)))
    gallery = Gallery(("log", "joint"), tuple(views))
    if not robot:
        return PageSection("Torques", (_TORQUES, gallery))
    *said, view = robot
    return PageSection("The robot and its torques", (_TORQUES, *said, Beside((view,), (gallery,))))


def simulation_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section of the free simulations, where there are any."""
    if not identification.runs:
        return
    heads = (Column("log", numeric=False), Column("driven by", numeric=False), Column("joint", numeric=False))
    columns = (*heads, *map(Column, ("position error, %", "of its way, %", "rms", "torque error, %")))
    units = {joint.name: joint.unit for joint in identification.model.joints}
    rows = [
        (
            run.name,
            run.driver if run.restart is None else f"{run.driver}, {run.restart:g} s",
            joint,
            number(run.relative_error[joint], 3),
            number(run.motion_error[joint], 3),
            f"{number(run.rms[joint], 3)} {units[joint]}",
            number(run.torque_error.get(joint), 3),
        )
        for run in identification.runs
        for joint in run.joints
    ]
    failures = tuple(f"{run.name}: {words(run.failure)}" for run in identification.runs if run.failure)
    table = PageTable(columns, tuple(rows), "Free simulation beside the measured position")
    yield PageSection("Free simulation", (_RUNS, *((failures,) if failures else ()), table, *_runs(identification)))


def _runs(identification: Identification) -> Iterator[Gallery]:
    units, fine = {joint.name: joint.unit for joint in identification.model.joints}, points(identification)
    runs = {run.name: run for run in identification.runs if not run.failure}
    views = tuple(
        (
            (label, joint),
            (
                Figure(
                    figures.run_figure(run, joint, units[joint], fine).of(label),
                    f"{joint}: measured and simulated position.",
                ),
            ),
        )
        for label, k in labelled(identification)
        if (run := runs.get(identification.validations[k].name))
        for joint in run.joints
    )
    if views:
        yield Gallery(("log", "joint"), views)
