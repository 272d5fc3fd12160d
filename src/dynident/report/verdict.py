"""The head of an identification's report: the verdict, its three numbers, and what to do next."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dynident.identification import Remedy, Use, judge
from dynident.report.advice import IN_SENTENCES, designed, sentences
from dynident.report.page import Badge, Facts, Fold, PageBlock, PageSection, number
from dynident.report.wording import words
from dynident.report.words import logs_of

if TYPE_CHECKING:
    from dynident.identification import Identification, Verdict
    from dynident.validation import LogValidation

__all__ = ["verdict_results", "verdict_section", "verdict_text"]

TONES: dict[Use, Literal["good", "fair", "bad"]] = {Use.SIMULATION: "good", Use.CONTROL: "fair", Use.DO_NOT_USE: "bad"}
FIRST_STEPS = 3  # in sight; the others are behind a fold
MOST_STEPS = 5  # besides remedies, in a terminal; the report has all


def verdict_text(identification: Identification) -> tuple[str, tuple[str, ...]]:
    """Return for a terminal the verdict in one paragraph, and the next steps: remedies, and the largest gains."""
    verdict = judge(identification)
    left = [one for one in verdict.next if not isinstance(one, Remedy)][MOST_STEPS:]
    steps = tuple(text for one, text in zip(verdict.next, _next_words(verdict), strict=True) if one not in left)
    more = (f"{len(left)} more, which the report lists.",) if left else ()
    return f"Verdict: {' '.join(sentences(verdict))}", (*steps, *more)


def verdict_section(identification: Identification) -> PageSection:
    """Return the verdict in three sentences, three numbers, what to do next, and all reasons behind a fold."""
    verdict = judge(identification)
    steps, reasons = _next_words(verdict), tuple(map(words, verdict.reasons))
    blocks: list[PageBlock] = [*sentences(verdict), Facts(tuple(_numbers(identification)), large=True)]
    if steps:
        more = (Fold(f"{len(steps) - FIRST_STEPS} more", (steps[FIRST_STEPS:],)),) if len(steps) > FIRST_STEPS else ()
        blocks.append(PageSection("What to do next", (steps[:FIRST_STEPS], *more)))
    if len(reasons) > IN_SENTENCES:
        blocks.append(Fold(f"All {len(reasons)} reasons against more use", (reasons,)))
    return PageSection("Verdict", tuple(blocks), Badge(verdict.use.value, TONES[verdict.use]))


def verdict_results(identification: Identification) -> dict[str, Any]:
    """Return the verdict in words."""
    verdict = judge(identification)
    return {
        "verdict": {
            "word": verdict.use.value,
            "sentences": list(sentences(verdict)),
            "reasons": [words(reason) for reason in verdict.reasons],
            "next_steps": list(_next_words(verdict)),
        }
    }


def _next_words(verdict: Verdict) -> tuple[str, ...]:
    """Return what to do next; the first step of each kind of motion names the command that designs it."""
    found, named = [], set[str]()
    for step in verdict.next:
        options, text = designed(step), words(step)
        if options is not None and options not in named:
            text += f" `dynident excite RESULT.json{options} -o FOLDER` designs such a motion."
            named.add(options)
        found.append(text)
    return tuple(found)


def _numbers(identification: Identification) -> Iterator[tuple[str, ...]]:
    """Yield the three numbers: held-out error, its worst joint, and the free simulation or what the error weighs.

    Of a single joint the second is what the error weighs.
    """
    held, train = logs_of(identification, "validation"), logs_of(identification, "train")
    yield _whole(held, train)
    logs, said = (held, "held out") if held else (train, "training")
    worst = _worst([((log, joint), size) for log in logs for joint, size in _joints(log).items()])
    if worst is None:
        return
    (log, joint), size = worst
    weight = _weight(identification, logs, said)
    if len(identification.model.joints) > 1:
        rms = f"{joint}, rms {_rms(identification, log, joint)}{' as measured' * bool(log.errors.per_joint_filtered)}"
        yield f"{number(size, 3)} %", f"worst joint, {said}", rms
        yield _run(identification) if identification.runs else weight
    else:
        yield weight
        if identification.runs:
            yield _run(identification)


def _whole(held: list[LogValidation], train: list[LogValidation]) -> tuple[str, ...]:
    trained = max(map(_error, train))
    if not held:
        return "-", "torque error, held out", f"no log was held out; training {number(trained, 3)} %"
    log = max(held, key=_error)
    note = f"training {number(trained, 3)} %"
    if log.errors.relative_error_filtered is not None:
        note = f"after the low-pass of the fit; {note}; as measured {number(log.errors.relative_error, 3)} %"
    return f"{number(_error(log), 3)} %", "torque error, held out", note


def _run(identification: Identification) -> tuple[str, ...]:
    what = "position error, free simulation"
    if failed := [run for run in identification.runs if run.failure]:
        return "fails", what, f"{failed[0].name}: {words(failed[0].failure)}"
    errors = [((run, joint), size) for run in identification.runs for joint, size in run.motion_error.items()]
    found = _worst(errors)
    if found is None:
        return "-", what, "nothing moved"
    (run, joint), size = found
    how = "in the controller's loop" if run.restart is None else f"within {run.restart:g} s of the measured torque"
    return f"{number(size, 2)} %", what, f"of the way of {joint} ({run.name}), {how}"


def _weight(identification: Identification, logs: list[LogValidation], said: str) -> tuple[str, ...]:
    """Return the largest rms error in % of what a joint may exert, or, where no limit is known, in its unit."""
    worst = _worst([((log, joint), size) for log in logs for joint, size in log.errors.effort_share.items()])
    if worst is not None:
        (log, joint), size = worst
        limit = number(identification.model.limits[joint].effort, 3)
        return (
            f"{number(size, 2)} %",
            f"rms error against effort limit, {said}",
            f"{joint}: {_rms(identification, log, joint)} of {limit}",
        )
    worst = _worst([((log, joint), size) for log in logs for joint, size in log.errors.rmse.items()])
    if worst is None:
        return "-", f"largest rms error, {said}"
    (log, joint), _ = worst
    return _rms(identification, log, joint), f"largest rms error, {said}", f"{joint}, {log.name}"


def _worst(sizes: list[tuple[Any, float]]) -> tuple[Any, float] | None:
    """Return what has the largest size, and the size; None where there is none."""
    known = [pair for pair in sizes if not np.isnan(pair[1])]
    return max(known, key=lambda pair: pair[1]) if known else None


def _rms(identification: Identification, log: LogValidation, joint: str) -> str:
    unit = next(one.effort for one in identification.model.joints if one.name == joint)
    return f"{number(log.errors.rmse[joint], 3)} {unit}"


def _error(log: LogValidation) -> float:
    """Return the error that the verdict judges: after the low-pass of the fit, where one is used."""
    return (
        log.errors.relative_error if log.errors.relative_error_filtered is None else log.errors.relative_error_filtered
    )


def _joints(log: LogValidation) -> dict[str, float]:
    return dict(log.errors.per_joint_filtered or log.errors.per_joint)
