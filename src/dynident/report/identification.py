"""The report of an identification: HTML page, terminal tables, and the plain dictionary for a result file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident import plot
from dynident.report.exports import export_results, export_section
from dynident.report.page import Block, Column, Facts, Figure, Section, Table, number, pairs, render, terminal
from dynident.report.parameters import (
    base_section,
    brief,
    consistency_section,
    parameter_blocks,
    parameter_results,
    rank_sentence,
    terminal_parameters,
)
from dynident.report.verdict import residual_table, simulation_section, verdict_results, verdict_section

if TYPE_CHECKING:
    import rich.table

    from dynident.export import Export
    from dynident.identify import Identification
    from dynident.validation import LogValidation

__all__ = ["identification_notes", "identification_page", "identification_tables", "result_dict"]

WELL = 10.0  # a parameter is called well determined up to this standard error, % of its value
MOST_NAMES = 12  # names of uncertain parameters in a sentence
ALL_POINTS = 70_000  # points of all curves of a page together, so that it stays near 1 MB


def identification_page(identification: Identification, exports: Sequence[Export] = ()) -> str:
    """Return the identification as one HTML page: findings, parameters, errors, torques, smoothing, settings."""
    sections = [
        verdict_section(identification),
        Section("What was found", tuple(_found(identification))),
        Section("Parameters", parameter_blocks(identification)),
        *base_section(identification),
        *consistency_section(identification),
        Section("Errors", (_ERRORS, *_error_tables(identification), *residual_table(identification))),
        *simulation_section(identification),
        Section("Torques", (_TORQUES, *_torques(identification))),
        Section("Smoothing", (_SMOOTHING, *_smoothing(identification), *_motions(identification))),
        *export_section(exports),
        Section("Warnings", (tuple(identification.warnings) or "None.",)),
        Section("Settings and versions", tuple(_settings(identification))),
    ]
    lead = f"Dynamic parameters from {_count(len(identification.logs), 'log')}: {_names(identification.logs)}."
    return render(f"Identification of {identification.model.name}", lead, sections)


def identification_tables(identification: Identification) -> list[rich.table.Table]:
    """Return for a terminal: the parameters, the errors per log, and the errors per log and joint."""
    parameters, _ = terminal_parameters(identification)
    return [terminal(table) for table in (parameters, _error_table(identification), _joint_table(identification))]


def identification_notes(identification: Identification) -> list[str]:
    """Return for a terminal what to say below the tables: of the parameters, then the warnings, long ones cut."""
    _, notes = terminal_parameters(identification)
    return [*notes, *(f"Warning: {brief(warning)}" for warning in identification.warnings)]


def result_dict(identification: Identification, exports: Sequence[Export] = ()) -> dict[str, Any]:
    """Return the result as plain dictionaries, texts and floats (which may be infinite or NaN).

    Keys: verdict, mass_matrix, simulation (by log), parameters (list of name, value, std and std_hac, unit and, where
    known, verdict), where known base_parameters, eigenvalues and costs, rank, condition, train and validation (by log:
    relative_error and relative_error_filtered in %, by joint rmse, per_joint and per_joint_filtered (%), effort_share
    (%), explained, and the tests of the residuals), exports (the model's files), status, warnings, versions, settings.
    ``std`` assumes independent residuals, ``std_hac`` allows for correlated ones.
    """
    estimate = identification.estimate
    return {
        **verdict_results(identification),
        **parameter_results(identification),
        "rank": int(estimate.rank),
        "condition": float(estimate.condition),
        "train": {log.name: _errors(log) for log in _role(identification, "train")},
        "validation": {log.name: _errors(log) for log in _role(identification, "validation")},
        "exports": export_results(exports),
        "status": estimate.status,
        "warnings": list(identification.warnings),
        "versions": dict(identification.versions),
        "settings": dict(identification.settings),
    }


def _errors(log: LogValidation) -> dict[str, Any]:
    filtered = log.relative_error_filtered
    return {
        "relative_error": float(log.relative_error),
        "relative_error_filtered": None if filtered is None else float(filtered),
        "rmse": {joint: float(value) for joint, value in log.rmse.items()},
        "per_joint": {joint: float(value) for joint, value in log.per_joint.items()},
        "per_joint_filtered": dict(log.per_joint_filtered),
        "effort_share": dict(log.effort_share),
        "explained": dict(log.explained),
        "residuals": {joint: {**asdict(test), "words": test.words} for joint, test in log.residuals.items()},
    }


def _found(identification: Identification) -> Iterator[Block]:
    train, held_out = _role(identification, "train"), _role(identification, "validation")
    estimate = identification.estimate
    relative = plot.relative_std(estimate)
    well = int((relative <= WELL).sum())
    yield Facts(
        (
            (_span(train), "torque error, training"),
            (_span(held_out), "torque error, held out"),
            (f"{well} of {len(relative)}", f"parameters within {WELL:g} % standard error"),
            (number(estimate.condition, 3), "condition number"),
        )
    )
    size = f"{_count(len(relative), 'parameter')} ({_count(estimate.rank, 'independent combination')})"
    fit = (
        f"From {_count(len(train), 'log')}, {size} of {identification.model.name} were estimated; the model leaves "
        f"{_span(train)} of the measured torque there unexplained (unfiltered, in the norm over all joints)."
    )
    test = "No log was held out, so nothing here says how well the model predicts motions that it has not seen."
    if held_out:
        test = f"On {_count(len(held_out), 'log')} that the fit has not seen, it leaves {_span(held_out)} unexplained."
    unsure = [name for name, value in zip(estimate.names, relative, strict=True) if not value <= WELL]
    more = f" and {len(unsure) - MOST_NAMES} more" if len(unsure) > MOST_NAMES else ""
    rest = f"; less certain: {', '.join(unsure[:MOST_NAMES])}{more}" if unsure else ""
    sure = f"{well} of {len(relative)} parameters have a standard error of at most {WELL:g} %{rest}."
    yield (fit, test, sure, *rank_sentence(identification))
    if estimate.status not in identification.warnings:
        yield f"Status of the fit: {estimate.status}"
    if identification.warnings:
        yield f"{_count(len(identification.warnings), 'warning')}, listed below."


_ERRORS = (
    "The relative error is the norm of measured minus predicted torque, in percent of the norm of the measured torque. "
    "Unfiltered is what the torque sensor saw; filtered is after the low-pass of the fit, where one was used."
)


def _error_tables(identification: Identification) -> tuple[Table, Table]:
    return _error_table(identification), _joint_table(identification)


def _error_table(identification: Identification) -> Table:
    words = (Column("log", numeric=False), Column("role", numeric=False))
    columns = (*words, Column("samples"), Column("unfiltered, %"), Column("filtered, %"))
    rows = [
        (
            log.name,
            _ROLES.get(log.role, log.role),
            str(int(log.motion.mask.sum())),
            number(log.relative_error, 3),
            number(log.relative_error_filtered, 3),
        )
        for log in identification.logs
    ]
    return Table(columns, tuple(rows), "Relative torque error per log")


_ROLES = {"train": "training", "validation": "held out"}


def _joint_table(identification: Identification) -> Table:
    columns = (Column("log", numeric=False), Column("joint", numeric=False), Column("error, %"), Column("rmse"))
    rows = [
        (
            log.name,
            joint.name,
            number(log.per_joint.get(joint.name), 3),
            number(log.rmse.get(joint.name), 3),
            joint.effort,
        )
        for log in identification.logs
        for joint in identification.model.joints
    ]
    return Table((*columns, Column("unit", numeric=False)), tuple(rows), "Torque error per log and joint, unfiltered")


_TORQUES = (
    "Measured and predicted torque, and below their difference. Drag over a part to zoom, double-click to return."
)


def _torques(identification: Identification) -> Iterator[Section]:
    points = _points(identification)
    for log in identification.logs:
        figures = (
            Figure(
                plot.torque_figure(log, joint.name, joint.effort, points),
                f"{joint.name}: relative error {number(log.per_joint.get(joint.name), 3)} %, "
                f"rmse {number(log.rmse.get(joint.name), 3)} {joint.effort}.",
            )
            for joint in identification.model.joints
        )
        yield Section(f"{log.name} ({_ROLES.get(log.role, log.role)})", tuple(figures))


_HEADS = {"sigma": "sigma, rad or m", "noise": "noise, rad or m", "bandwidth": "bandwidth, s"}
_SMOOTHING = "How positions were smoothed, per log and joint, and the motion that the regression has seen."


def _smoothing(identification: Identification) -> Iterator[Block]:
    """Yield one table of what the smoothers say in one number per joint, and their words below it."""
    motions = [(log.name, log.motion) for log in identification.logs]
    keys = list(dict.fromkeys(key for _, motion in motions for key in motion.smoothing if _per_joint(motion, key)))
    if keys:
        rows = [
            (name, joint, *(_smoothing_cell(motion, key, j) for key in keys))
            for name, motion in motions
            for j, joint in enumerate(motion.joints)
        ]
        columns = (
            Column("log", numeric=False),
            Column("joint", numeric=False),
            *(Column(_HEADS.get(key, key)) for key in keys),
        )
        yield Table(columns, tuple(rows), "Smoothing per log and joint")
    words = [
        f"{name}: " + ", ".join(f"{key} {value}" for key, value in motion.smoothing.items() if isinstance(value, str))
        for name, motion in motions
        if any(isinstance(value, str) for value in motion.smoothing.values())
    ]
    if words:
        yield tuple(words)


def _per_joint(motion: Any, key: str) -> bool:
    value = motion.smoothing.get(key)
    return value is not None and not isinstance(value, str) and np.shape(value) == (len(motion.joints),)


def _smoothing_cell(motion: Any, key: str, j: int) -> str:
    return number(float(motion.smoothing[key][j])) if _per_joint(motion, key) else "-"


def _motions(identification: Identification) -> Iterator[Section]:
    points = _points(identification)
    for log in identification.logs:
        figures = (
            Figure(plot.motion_figure(log.motion, joint.name, joint.unit, points), f"{joint.name}.")
            for joint in identification.model.joints
        )
        yield Section(log.name, tuple(figures))


def _settings(identification: Identification) -> Iterator[Block]:
    yield pairs("setting", list(identification.settings.items()), "Settings")
    yield pairs("package", list(identification.versions.items()), "Versions")
    residual = zip(identification.model.joints, identification.estimate.sigma, strict=True)
    rows = tuple((joint.name, number(float(sigma)), joint.effort) for joint, sigma in residual)
    columns = (Column("joint", numeric=False), Column("sigma"), Column("unit", numeric=False))
    yield Table(columns, rows, "Standard deviation of the torque residual")


def _points(identification: Identification) -> int:
    """Share the page's points among its curves: six per log and joint."""
    curves = 6 * max(len(identification.logs) * len(identification.model.joints), 1)
    return int(np.clip(ALL_POINTS // curves, 100, 2000))


def _role(identification: Identification, role: str) -> list[LogValidation]:
    return [log for log in identification.logs if log.role == role]


def _span(logs: Sequence[LogValidation]) -> str:
    """Word the relative error of one log, or the range over several."""
    texts = [number(bound(log.relative_error for log in logs), 3) for bound in (min, max)] if logs else ["-"]
    return " to ".join(dict.fromkeys(texts)) + (" %" if logs else "")


def _names(logs: Sequence[LogValidation]) -> str:
    return ", ".join(log.name for log in logs) or "none"


def _count(number_of: int, noun: str) -> str:
    return f"{number_of} {noun}{'' if number_of == 1 else 's'}"
