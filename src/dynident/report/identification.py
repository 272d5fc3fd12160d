"""The report of an identification: HTML page, terminal tables, and the plain dictionary for a result file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from dynident.report.data import data_section, smoothing_section
from dynident.report.exports import export_results, export_section
from dynident.report.page import Fold, PageBlock, PageSection, render, terminal
from dynident.report.parameters import LONGEST, brief, parameter_results, parameter_section, terminal_parameters
from dynident.report.repeat import repeat_section
from dynident.report.structure import base_section, condition_section, consistency_section
from dynident.report.validation import error_section, error_table, joint_table, simulation_section, torque_section
from dynident.report.verdict import verdict_results, verdict_section
from dynident.report.wording import Line, causes_words, note_lines, settings_of, status_words, words
from dynident.report.words import ROLES, count, listed, logs_of

if TYPE_CHECKING:
    import rich.table

    from dynident.export import Export
    from dynident.identification import Identification
    from dynident.validation import LogValidation

__all__ = ["identification_notes", "identification_page", "identification_tables", "result_dict"]


def identification_page(identification: Identification, exports: Sequence[Export] = ()) -> str:
    """Return the identification as one HTML page: the verdict, what was measured and found, and how to repeat it."""
    sections = [
        verdict_section(identification),
        data_section(identification),
        error_section(identification),
        torque_section(identification),
        *simulation_section(identification),
        parameter_section(identification),
        *base_section(identification),
        condition_section(identification),
        *consistency_section(identification),
        smoothing_section(identification),
        *export_section(exports),
        PageSection("Warnings", tuple(_warnings(identification))),
        repeat_section(identification),
    ]
    return render(f"Identification of {identification.model.name}", _lead(identification), sections)


def _lead(identification: Identification) -> str:
    model = identification.model
    logs = "; ".join(
        f"{word}: {listed(log.name for log in logs)}"
        for role, word in ROLES.items()
        if (logs := logs_of(identification, role))
    )
    return (
        f"{count(len(model.parameters), 'parameter')} of {count(len(model.joints), 'joint')} from "
        f"{count(len(identification.validations), 'log')}. {logs[:1].upper()}{logs[1:]}."
    )


def _warnings(identification: Identification) -> Iterator[PageBlock]:
    yield tuple(words(note) for note in identification.warnings) or "None."
    rest = [note for note in identification.estimate.notes if note not in identification.warnings]
    if status := "; ".join(map(words, rest)):
        yield Fold("Status of the fit", (f"{status}.",)) if len(status) > LONGEST else f"Status of the fit: {status}."


def identification_tables(identification: Identification) -> list[rich.table.Table]:
    """Return for a terminal: the parameters, the errors per log, and the errors per log and joint."""
    parameters, _ = terminal_parameters(identification)
    return [terminal(table) for table in (parameters, error_table(identification), joint_table(identification))]


def identification_notes(identification: Identification) -> list[Line]:
    """Return for a terminal what to say below the tables: of the parameters, then the warnings, long ones cut."""
    _, notes = terminal_parameters(identification)
    lines = note_lines(identification.warnings)
    return [*map(Line, notes), *(Line(brief(line.text), line.severity) for line in lines)]


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
        "rank": int(estimate.determined.rank),
        "condition": float(estimate.determined.condition),
        "train": {log.name: _errors(log) for log in logs_of(identification, "train")},
        "validation": {log.name: _errors(log) for log in logs_of(identification, "validation")},
        "exports": export_results(exports),
        "status": status_words(estimate),
        "warnings": [words(note) for note in identification.warnings],
        "versions": dict(identification.provenance.versions),
        "settings": {**_sources(identification), **settings_of(identification)},
    }


def _errors(log: LogValidation) -> dict[str, Any]:
    filtered = log.errors.relative_error_filtered
    return {
        "relative_error": float(log.errors.relative_error),
        "relative_error_filtered": None if filtered is None else float(filtered),
        "rmse": {joint: float(value) for joint, value in log.errors.rmse.items()},
        "per_joint": {joint: float(value) for joint, value in log.errors.per_joint.items()},
        "per_joint_filtered": dict(log.errors.per_joint_filtered),
        "effort_share": dict(log.errors.effort_share),
        "explained": dict(log.errors.r2),
        "residuals": {joint: {**asdict(test), "words": causes_words(test)} for joint, test in log.residuals.items()},
    }


def _sources(identification: Identification) -> dict[str, str]:
    sources, found = identification.provenance, dict[str, str]()
    if sources.configuration:
        found |= {"configuration": sources.configuration.text, "configuration file": sources.configuration.path}
    if sources.model:
        found |= {"model file": sources.model.path, "model file SHA-256": sources.model.sha256}
    return found | {f"SHA-256 of {one.path}": one.sha256 for one in sources.logs}
