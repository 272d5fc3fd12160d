"""The report of an identification: its verdict, its page, its notes in a terminal, and the files of a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dynident.files.meshes import result_geometry, rods_for
from dynident.files.results import json_text
from dynident.identification import Remedy, judge
from dynident.identification.links import rigid_bodies
from dynident.identification.verdict import NAMED_REASONS, ForbiddingFindings
from dynident.identification.verdict_steps import CheckRipple, Cover, Sharpen, SlowReversals
from dynident.project.saved import result_data
from dynident.regression import UnexcitedParameters
from dynident.report.check import finding_groups, finding_table
from dynident.report.equations import model_section
from dynident.report.figures import clock
from dynident.report.identification.data import data_section, pieces_section, repeat_section, smoothing_section
from dynident.report.identification.figures import glance_figure
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
from dynident.report.words import ROLES, Line, day, label_of, logs_of, note_lines
from dynident.runtime import Severity, Use, count, join_names, number, place_and_text
from dynident.validation import FloorOrigin, residual_text

if TYPE_CHECKING:
    from dynident.identification import Identification, Verdict
    from dynident.models import Geometry
    from dynident.project.export import Export
    from dynident.runtime import Finding
    from dynident.validation import LogValidation

TONES: dict[Use, Literal["good", "fair", "bad"]] = {Use.SIMULATION: "good", Use.CONTROL: "good", Use.DO_NOT_USE: "bad"}
STYLES = {use: "red" if tone == "bad" else "green" for use, tone in TONES.items()}  # in a terminal
HEAD_SENTENCES = 3  # above the numbers
MAX_OPEN_STEPS = 3  # in sight; the others are behind a fold
MAX_TERMINAL_STEPS = 5  # besides remedies, in a terminal; the report has all


MAX_FINDINGS = 5  # findings of the checks in a terminal
MAX_LISTED = 3  # logs in a line


def head_numbers(identification: Identification) -> Iterator[tuple[str, ...]]:
    """Yield the numbers at the head of the report.

    They are the error over what the sensors allow where that is known, the held-out error, its worst joint, and
    the free simulation or the error relative to the effort limit. Of a single joint the latter is the third.
    """
    held_out, train = logs_of(identification, "validation"), logs_of(identification, "train")
    logs, role_word = (held_out, "held out") if held_out else (train, "training")
    log = max(logs, key=_judged_error)
    yield from _floor_ratio(log)
    *numbers, note = _torque_error(held_out, train)
    yield *numbers, note + "; the noise of the sensors is not known" * (log.over_floor is None)
    worst = worst_joint(identification)
    if worst is None:
        return
    log, joint = worst
    size = _joint_errors(log)[joint]
    weight = _effort_share(identification, logs, role_word)
    # A single joint is not named as the worst: the error relative to its effort limit takes the place
    if len(identification.model.joints) > 1:
        rms = f"{_as_measured(log, joint)}rms {_rms(identification, log, joint)}"
        yield f"{number(size, 3)} %", f"worst joint{_low_pass_words(log)}, {role_word}", f"{joint}, {rms}"
        yield _simulation_error(identification) if identification.runs else weight
    else:
        yield weight
        if identification.runs:
            yield _simulation_error(identification)


def worst_joint(identification: Identification) -> tuple[LogValidation, str] | None:
    """Return the joint with the largest relative error and its log, a held-out one where there is any."""
    logs = logs_of(identification, "validation") or logs_of(identification, "train")
    worst = _largest([((log, joint), size) for log in logs for joint, size in _joint_errors(log).items()])
    return None if worst is None else worst[0]


def _floor_ratio(log: LogValidation) -> Iterator[tuple[str, ...]]:
    """Yield the error on a log over what the sensors allow, and how that is known."""
    if log.over_floor is None:
        return
    white = any(floor.origin is FloorOrigin.WHITE for floor in log.floors.values())
    coverage = f"; {len(log.floors)} of {len(log.errors.rmse)} joints" * (len(log.floors) < len(log.errors.rmse))
    how = "at most, by white noise alone" if white else "by motion that repeats"
    yield (
        f"{number(log.over_floor, 3 if log.over_floor < 1.5 else 2)} ×",
        "error relative to sensor noise",
        "at the noise floor" if log.at_floor else f"{how}{coverage}",
    )


def _torque_error(held_out: list[LogValidation], train: list[LogValidation]) -> tuple[str, ...]:
    trained = max(map(_judged_error, train))
    if not held_out:
        return "-", "torque error, held out", f"no log was held out; training {number(trained, 3)} %"
    log = max(held_out, key=_judged_error)
    low_pass, note = _low_pass_words(log), f"training {number(trained, 3)} %"
    note += f"; as measured {number(log.errors.relative_error, 3)} %" * bool(low_pass)
    return f"{number(_judged_error(log), 3)} %", f"torque error{low_pass}, held out", note


def _simulation_error(identification: Identification) -> tuple[str, ...]:
    title = "position error, free simulation"
    if failed := [run for run in identification.runs if run.failure]:
        return "fails", title, f"{failed[0].name}: {failed[0].failure}"
    errors = [((run, joint), size) for run in identification.runs for joint, size in run.motion_error.items()]
    worst = _largest(errors)
    if worst is None:
        return "-", title, "nothing moved"
    (run, joint), size = worst
    how = "in the controller's loop" if run.restart is None else f"within {run.restart:g} s of the measured torque"
    return f"{number(size, 2)} %", title, f"of the motion of {joint} ({run.name}), {how}"


def _effort_share(identification: Identification, logs: list[LogValidation], role_word: str) -> tuple[str, ...]:
    """Return the largest rms error in % of the joint's effort limit, or in its unit where no limit is known."""
    worst = _largest([((log, joint), size) for log in logs for joint, size in log.errors.effort_share.items()])
    if worst is not None:
        (log, joint), size = worst
        limit = number(identification.model.limits[joint].effort, 3)
        return (
            f"{number(size, 2)} %",
            f"rms of effort limit, {role_word}",
            f"{joint}: {_rms(identification, log, joint)} of {limit}",
        )
    worst = _largest([((log, joint), size) for log in logs for joint, size in log.errors.rmse.items()])
    if worst is None:
        return "-", f"largest rms error, {role_word}"
    (log, joint), _ = worst
    return _rms(identification, log, joint), f"largest rms error, {role_word}", f"{joint}, {log.name}"


def _largest(sizes: list[tuple[Any, float]]) -> tuple[Any, float] | None:
    """Return the entry with the largest size, and the size; None where there is none."""
    finite = [pair for pair in sizes if not np.isnan(pair[1])]
    return max(finite, key=lambda pair: pair[1]) if finite else None


def _rms(identification: Identification, log: LogValidation, joint: str) -> str:
    unit = next(candidate.effort for candidate in identification.model.joints if candidate.name == joint)
    return f"{number(log.errors.rmse[joint], 3)} {unit}"


def _judged_error(log: LogValidation) -> float:
    """Return the error that the verdict judges: after the low-pass of the fit, where one is used."""
    errors = log.errors
    return errors.relative_error if errors.relative_error_filtered is None else errors.relative_error_filtered


def _low_pass_words(log: LogValidation) -> str:
    """Return where the errors that are judged are taken: a title says it, as other numbers are as measured."""
    return "" if log.errors.relative_error_filtered is None else " after the low-pass"


def _as_measured(log: LogValidation, joint: str) -> str:
    """Return the error of a joint as measured, to which its rms belongs, where another one is judged."""
    return f"as measured {number(log.errors.per_joint[joint], 3)} %, " * bool(log.errors.per_joint_filtered)


def _joint_errors(log: LogValidation) -> dict[str, float]:
    return dict(log.errors.per_joint_filtered or log.errors.per_joint)


def verdict_text(identification: Identification, sentences: int | None = HEAD_SENTENCES) -> str:
    """Return the verdict for a terminal in one paragraph of so many sentences, or of all."""
    return f"Verdict: {' '.join(judge(identification).sentences()[:sentences])}"


def next_step_texts(identification: Identification) -> tuple[str, ...]:
    """Return the next steps for a terminal: remedies, and those with the largest gains."""
    verdict = judge(identification)
    omitted = [step for step in verdict.next if not isinstance(step, Remedy)][MAX_TERMINAL_STEPS:]
    steps = tuple(text for step, text in zip(verdict.next, _step_texts(verdict), strict=True) if step not in omitted)
    return (*steps, *((f"{len(omitted)} more, which the report lists.",) if omitted else ()))


def summary_lines(identification: Identification) -> Iterator[str]:
    """Yield the torque errors of training and held-out logs, unfiltered, and the worst joint."""
    for role, word in ROLES.items():
        if logs := logs_of(identification, role):
            errors = (f"{log.name} {number(log.errors.relative_error, 3)} %" for log in logs)
            yield f"Torque error, {word}: {join_names(errors, MAX_LISTED)}"
    if len(identification.model.joints) > 1 and (worst := worst_joint(identification)) is not None:
        log, joint = worst
        judged = f" ({number(_joint_errors(log)[joint], 3)} % after the low-pass)" * bool(log.errors.per_joint_filtered)
        size = f"{number(log.errors.per_joint[joint], 3)} % on {log.name}{judged}"
        yield f"Worst joint: {joint}, {size}, rms {_rms(identification, log, joint)}"


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
    is_named = all(reason in texts[1] for reason in reasons)
    fold = (
        () if is_named else (Fold(f"All {len(reasons)} reasons" if reasons[1:] else "The reason in full", (reasons,)),)
    )
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
    logs = "; ".join(
        f"{word}: {join_names(log.name for log in logs)}"
        for role, word in ROLES.items()
        if (logs := logs_of(identification, role))
    )
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
_DESIGNED_STEPS = {
    "": (Sharpen, Cover, UnexcitedParameters),
    " --program friction": (SlowReversals, CheckRipple),
}
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
    corrections = [
        *([offset] if offset is not None and offset.seconds else ()),
        *([tilt] if tilt is not None and (tilt.x or tilt.y) else ()),
    ]
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
