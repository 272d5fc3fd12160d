"""The report of an identification: its verdict, its page, its notes in a terminal, and the files of a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Literal

from dynident.files.meshes import result_geometry, rods_for
from dynident.files.results import json_text
from dynident.identification import Identification, Remedy, Verdict, judge
from dynident.identification.links import rigid_bodies
from dynident.identification.verdict import NAMED_REASONS
from dynident.identification.verdict_reasons import ForbiddingFindings
from dynident.identification.verdict_steps import CheckRipple, Cover, Sharpen, SlowReversals
from dynident.models import Geometry
from dynident.project.export import Export
from dynident.project.saved import result_data
from dynident.regression import UnexcitedParameters
from dynident.report.check import finding_groups, finding_table
from dynident.report.equations import model_section
from dynident.report.figures import clock
from dynident.report.identification.data import data_section, pieces_section, repeat_section, smoothing_section
from dynident.report.identification.figures import glance_figure
from dynident.report.identification.head import head_numbers, worst_joint
from dynident.report.identification.parameters import (
    MAX_WARNING_LENGTH,
    link_section,
    parameter_section,
    shorten_warning,
    terminal_parameters,
)
from dynident.report.identification.robot import export_links, export_results, export_section, robot_blocks, robot_view
from dynident.report.identification.terms import (
    base_section,
    condition_section,
    consistency_section,
    term_section,
    term_table,
)
from dynident.report.identification.validation import (
    error_section,
    error_table,
    joint_table,
    simulation_section,
    torque_section,
    unknown_noise,
)
from dynident.report.page import Badge, Beside, Facts, Figure, Fold, PageBlock, PageSection, PageTable, render
from dynident.report.words import ROLES, Line, day, label_of, note_lines
from dynident.runtime import Finding, Severity, Use, count, join_names, number, place_and_text
from dynident.validation import residual_text

TONES: dict[Use, Literal["good", "fair", "bad"]] = {Use.SIMULATION: "good", Use.CONTROL: "good", Use.DO_NOT_USE: "bad"}
STYLES = {use: "red" if tone == "bad" else "green" for use, tone in TONES.items()}  # in a terminal
HEAD_SENTENCES = 3  # above the numbers
MAX_OPEN_STEPS = 3  # in sight; the others are behind a fold
MAX_TERMINAL_STEPS = 5  # besides remedies, in a terminal; the report has all
MAX_FINDINGS = 5  # findings of the checks in a terminal


def verdict_text(identification: Identification, sentences: int | None = HEAD_SENTENCES) -> str:
    """Return the verdict for a terminal in one paragraph of so many sentences, or of all."""
    return f"Verdict: {' '.join(judge(identification).sentences()[:sentences])}"


def next_step_texts(identification: Identification) -> tuple[str, ...]:
    """Return the next steps for a terminal: remedies, and those with the largest gains."""
    verdict = judge(identification)
    omitted = [step for step in verdict.next if not isinstance(step, Remedy)][MAX_TERMINAL_STEPS:]
    steps = tuple(text for step, text in zip(verdict.next, _step_texts(verdict), strict=True) if step not in omitted)
    return (*steps, *((f"{len(omitted)} more, which the report lists.",) if omitted else ()))


def verdict_section(
    identification: Identification, exports: Sequence[Export] = (), arm: Figure | None = None
) -> PageSection:
    """Return the verdict in three sentences and its numbers, beside them the ``arm``, where there is one, and the
    torque of the worst joint; what to do next, links to the files beside the report, and all reasons behind a fold."""
    verdict = judge(identification)
    steps, reasons = _step_texts(verdict), tuple(map(str, verdict.reasons))
    texts = verdict.sentences()
    numbers = Facts(tuple(head_numbers(identification)), large=True)
    pictures: tuple[PageBlock, ...] = (*filter(None, (arm,)), *_worst_joint_figure(identification))
    title = f"All {len(reasons)} reasons" if reasons[1:] else "The reason in full"
    fold = () if verdict.names_all else (Fold(title, (reasons,)),)
    head: tuple[PageBlock, ...] = (*texts[:2], *fold, *texts[2:HEAD_SENTENCES], numbers, *export_links(exports))
    blocks: list[PageBlock] = list((Beside(head, pictures, "left"),) if pictures else head)
    if steps:
        more = Fold(f"{len(steps) - MAX_OPEN_STEPS} more", (steps[MAX_OPEN_STEPS:],))
        folded = (more,) if len(steps) > MAX_OPEN_STEPS else ()
        blocks.append(PageSection("What to do next", (steps[:MAX_OPEN_STEPS], *folded)))
    blocks += texts[HEAD_SENTENCES:]
    return PageSection("Verdict", tuple(blocks), Badge(verdict.use.value, TONES[verdict.use]))


def _step_texts(verdict: Verdict) -> tuple[str, ...]:
    """Return what to do next; the first step that needs a kind of motion names the command that designs it."""
    texts, named_options = [], set[str]()
    for step in verdict.next:
        options, text = design_options(step), str(step)
        if options is not None and options not in named_options:
            text += f" `dynident excite RESULT.json{options} -o FOLDER` designs such a motion."
            named_options.add(options)
        texts.append(text)
    return tuple(texts)


def _worst_joint_figure(identification: Identification) -> tuple[PageBlock, ...]:
    """Return the torque of the worst joint on the log that is judged."""
    worst = worst_joint(identification)
    if worst is None:
        return ()
    (log, joint), several = worst, len(identification.model.joints) > 1
    unit = next(candidate.effort for candidate in identification.model.joints if candidate.name == joint)
    size = f"{number(log.errors.per_joint[joint], 3)} % error{' as measured' * bool(log.errors.per_joint_filtered)}"
    caption = f"{joint} on {log.name}, {size}."
    drawing = glance_figure(log, joint, unit).follow_run(label_of(log))
    return (Figure(drawing, f"{'The worst joint: ' * several}{caption}"),)


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
        PageSection("Warnings", tuple(_warning_blocks(identification))),
        repeat_section(identification),
    ]
    return render(f"Identification of {identification.model.name}", _lead_text(identification), sections)


def _lead_text(identification: Identification) -> str:
    model = identification.model
    by_word = {word: identification.of_role(role) for role, word in ROLES.items()}
    logs = "; ".join(f"{word}: {join_names(log.name for log in logs)}" for word, logs in by_word.items() if logs)
    return (
        f"{count(len(model.parameters), 'parameter')} of {count(len(model.joints), 'joint')} from "
        f"{count(len(identification.validations), 'log')}. {logs[:1].upper()}{logs[1:]}.{_date_words(identification)}"
    )


def _date_words(identification: Identification) -> str:
    """Return when it was identified, and when it was recorded: by the stamps, else by the dates of the files."""
    sources = identification.provenance
    stamps = sorted({clock(float(log.motion.t[0]))[:10] for log in identification.validations} - {""})
    files = sorted({source.modified[:10] for source in sources.logs if source.modified})
    when = f" Identified {day(sources.identified)}." if sources.identified else ""
    if stamps or files:
        earliest, *_, latest = 2 * (stamps or files)
        when += f" {'Recorded' if stamps else 'Files of'} {earliest}{f' to {latest}' * (earliest != latest)}."
    return when


def _warning_blocks(identification: Identification) -> Iterator[PageBlock]:
    groups = _other_findings(identification)
    if identification.notes or not groups:
        yield tuple(map(str, identification.notes)) or "None."
    if groups:
        yield finding_table(groups, "What the checks found besides (`dynident check`)")
    notes = [note for note in identification.estimate.notes if note not in identification.notes]
    if status := "; ".join(map(str, notes)):
        is_long = len(status) > MAX_WARNING_LENGTH
        yield Fold("Status of the fit", (f"{status}.",)) if is_long else f"Status of the fit: {status}."


def identification_tables(identification: Identification) -> list[PageTable]:
    """Return the tables for a terminal: parameters, terms chosen, errors per log, and per log and joint."""
    parameters, _ = terminal_parameters(identification)
    choice = identification.calibration.terms
    terms = [] if choice is None or not choice.trials else [term_table(choice)]
    return [parameters, *terms, error_table(identification), joint_table(identification)]


# what designs the motion of a step, by the options of `dynident excite`
_DESIGNED_STEPS = {"": (Sharpen, Cover, UnexcitedParameters), " --program friction": (SlowReversals, CheckRipple)}
_DESIGNED_REMEDIES = (Remedy.EXCITE, Remedy.LONGER_TRAINING, Remedy.ANOTHER_MOTION)


def design_options(step: object) -> str | None:
    """Return the options of ``dynident excite`` that design the motion a step asks for, None for other steps."""
    if step in _DESIGNED_REMEDIES:
        return ""
    return next((options for options, kinds in _DESIGNED_STEPS.items() if isinstance(step, kinds)), None)


def identification_notes(identification: Identification) -> list[Line]:
    """Return the lines below the tables of a terminal: on the parameters, then warnings, long ones cut."""
    _, notes = terminal_parameters(identification)
    # What is among the notes is not said twice
    reason_lines = [
        Line(f"Warning: {reason}.", Severity.WARNING)
        for reason in judge(identification).reasons[NAMED_REASONS:]
        if isinstance(reason, ForbiddingFindings)
        and not all(finding.message in identification.notes for finding in reason.findings)
    ]
    other_lines = [*note_lines(identification.notes), *_check_lines(_other_findings(identification))]
    offset, tilt = identification.calibration.time_offset, identification.calibration.base_tilt
    corrections: list[object] = [offset] if offset is not None and offset.seconds else []
    corrections += [tilt] if tilt is not None and (tilt.x or tilt.y) else []
    return [
        *(Line(f"Note: {correction}.") for correction in corrections),
        *map(Line, (*notes, *unknown_noise(identification))),
        *(Line(shorten_warning(line.text), line.severity) for line in (*reason_lines, *other_lines)),
    ]


def _other_findings(identification: Identification) -> list[list[Finding]]:
    """Return groups of the findings that have no bearing on the verdict and are not reported elsewhere."""
    findings = [x for x in identification.findings if x.forbids is None and x.message not in identification.notes]
    # the others are next steps
    return finding_groups([finding for finding in findings if finding.severity is not Severity.INFO])


def _check_lines(groups: Sequence[Sequence[Finding]]) -> Iterator[Line]:
    for group in groups[:MAX_FINDINGS]:
        yield Line(f"Warning: {': '.join(filter(None, place_and_text(group)))}", Severity.WARNING)
    if len(groups) > MAX_FINDINGS:
        yield Line(f"Note: `dynident check` has {count(len(groups) - MAX_FINDINGS, 'more warning')}.")


def result_words(identification: Identification, exports: Sequence[Export] = ()) -> dict[str, Any]:
    """Return what a report adds to a result file: verdict, status and warnings as text, and the model's files."""
    verdict = judge(identification)
    return {
        "verdict": {
            "word": verdict.use.value,
            "sentences": list(verdict.sentences()),
            "reasons": list(map(str, verdict.reasons)),
            "next_steps": list(_step_texts(verdict)),
        },
        "status": "; ".join(map(str, identification.estimate.notes)) or "ok",
        "warnings": list(map(str, identification.notes)),
        "residuals": {
            log.name: {joint: text for joint in log.residuals if (text := residual_text(log, joint))}
            for log in identification.validations
        },
        "exports": export_results(exports),
    }


def run_files(identification: Identification, exports: Sequence[Export] = ()) -> dict[str, str]:
    """Return the texts of result.json and report.html."""
    bodies = rigid_bodies(identification)
    try:
        page = identification_page(identification, exports, result_geometry(identification))
    except Exception as error:  # of a shape that can be read, and not be drawn
        if bodies is None:
            raise
        page = identification_page(identification, exports, rods_for(bodies, error))
    result = result_data(identification, result_words(identification, exports))
    return {"result.json": json_text(result), "report.html": page}
