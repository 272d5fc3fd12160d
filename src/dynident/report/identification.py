"""The report of an identification: HTML page, terminal tables, and the words of a result file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from dynident.errors import Severity
from dynident.identification import judge
from dynident.identification.verdict.reasons import Noted
from dynident.report import figures
from dynident.report.advice import IN_SENTENCES
from dynident.report.check import finding_groups, finding_row, finding_table
from dynident.report.data import data_section, smoothing_section
from dynident.report.equations import model_section
from dynident.report.exports import export_results, export_section
from dynident.report.links import link_section
from dynident.report.page import Fold, PageBlock, PageSection, PageTable, render
from dynident.report.parameters import LONGEST, brief, parameter_section, terminal_parameters
from dynident.report.pieces import pieces_section
from dynident.report.repeat import repeat_section
from dynident.report.robot import robot_blocks, robot_view
from dynident.report.structure import base_section, condition_section, consistency_section
from dynident.report.terms import term_section, term_table
from dynident.report.validation import (
    error_section,
    error_table,
    joint_table,
    simulation_section,
    torque_section,
    unknown_noise,
)
from dynident.report.verdict import verdict_results, verdict_section
from dynident.report.wording import Line, note_lines, residual_words, status_words, words
from dynident.report.words import ROLES, count, day, listed, logs_of

if TYPE_CHECKING:
    from dynident.errors import Finding
    from dynident.excitation import Geometry
    from dynident.export import Export
    from dynident.identification import Identification

__all__ = ["identification_notes", "identification_page", "identification_tables", "result_words"]

MOST = 5  # findings of the checks in a terminal


def identification_page(
    identification: Identification, exports: Sequence[Export] = (), geometry: Geometry | None = None
) -> str:
    """Return the identification as one HTML page: the verdict, what was measured and found, and how to repeat it.

    ``geometry`` are the shapes of the robot; without it, its links are drawn as rods.
    """
    sections = [
        verdict_section(identification, exports, robot_view(identification, geometry)),
        data_section(identification),
        *model_section(identification),
        *pieces_section(identification),
        error_section(identification),
        torque_section(identification, tuple(robot_blocks(identification, geometry))),
        *simulation_section(identification),
        *term_section(identification),
        *link_section(identification, geometry),
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
        f"{count(len(identification.validations), 'log')}. {logs[:1].upper()}{logs[1:]}.{_dates(identification)}"
    )


def _dates(identification: Identification) -> str:
    """Return when it was identified, and when it was recorded by the stamps, or of what days the files are."""
    sources = identification.provenance
    stamps = sorted({figures.clock(float(log.motion.t[0]))[:10] for log in identification.validations} - {""})
    files = sorted({one.modified[:10] for one in sources.logs if one.modified})
    when = f" Identified {day(sources.identified)}." if sources.identified else ""
    if stamps or files:
        first, *_, last = 2 * (stamps or files)
        when += f" {'Recorded' if stamps else 'Files of'} {first}{f' to {last}' * (first != last)}."
    return when


def _warnings(identification: Identification) -> Iterator[PageBlock]:
    more = _more(identification)
    if identification.notes or not more:
        yield tuple(words(note) for note in identification.notes) or "None."
    if more:
        yield finding_table(more, "What the checks found besides (`dynident check`)")
    rest = [note for note in identification.estimate.notes if note not in identification.notes]
    if status := "; ".join(map(words, rest)):
        yield Fold("Status of the fit", (f"{status}.",)) if len(status) > LONGEST else f"Status of the fit: {status}."


def identification_tables(identification: Identification) -> list[PageTable]:
    """Return for a terminal: the parameters, the terms that were chosen, the errors per log, and per log and joint."""
    parameters, _ = terminal_parameters(identification)
    choice = identification.calibration.terms
    terms = [] if choice is None or not choice.trials else [term_table(choice)]
    return [parameters, *terms, error_table(identification), joint_table(identification)]


def identification_notes(identification: Identification) -> list[Line]:
    """Return for a terminal what to say below the tables: of the parameters, then the warnings, long ones cut."""
    _, notes = terminal_parameters(identification)
    more = [one for one in judge(identification).reasons[IN_SENTENCES:] if isinstance(one, Noted)]
    more = [one for one in more if not all(each.message in identification.notes for each in one.findings)]
    found = [Line(f"Warning: {words(one)}.", Severity.WARNING) for one in more]
    said = [*note_lines(identification.notes), *_check_lines(_more(identification))]
    return [
        *map(Line, (*notes, *unknown_noise(identification))),
        *(Line(brief(line.text), line.severity) for line in (*found, *said)),
    ]


def _more(identification: Identification) -> list[list[Finding]]:
    """Return the findings of the checks that have no bearing on the verdict and are not said elsewhere, like ones
    together."""
    known = identification.notes
    more = [one for one in identification.findings if one.forbids is None and one.message not in known]
    return finding_groups([one for one in more if one.severity is not Severity.INFO])  # the others are next steps


def _check_lines(groups: Sequence[Sequence[Finding]]) -> Iterator[Line]:
    for group in groups[:MOST]:
        yield Line(f"Warning: {': '.join(filter(None, finding_row(group)))}", Severity.WARNING)
    if len(groups) > MOST:
        yield Line(f"Note: `dynident check` has {count(len(groups) - MOST, 'more warning')}.")


def result_words(identification: Identification, exports: Sequence[Export] = ()) -> dict[str, Any]:
    """Return what a report adds to a result file: verdict, status and warnings in words, and the model's files."""
    return {
        **verdict_results(identification),
        "status": status_words(identification.estimate),
        "warnings": [words(note) for note in identification.notes],
        "residuals": {
            log.name: {joint: said for joint in log.residuals if (said := residual_words(log, joint))}
            for log in identification.validations
        },
        "exports": export_results(exports),
    }
