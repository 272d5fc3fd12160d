"""The head of an identification's report: the verdict, its three numbers, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

from dynident.identification import Remedy, Use, judge
from dynident.report import figures
from dynident.report.advice import IN_SENTENCES, designed, sentences
from dynident.report.exports import export_links
from dynident.report.head import head_numbers, worst_joint
from dynident.report.page import Badge, Beside, Facts, Figure, Fold, PageBlock, PageSection, number
from dynident.report.wording import words
from dynident.report.words import label_of

if TYPE_CHECKING:
    from dynident.export import Export
    from dynident.identification import Identification, Verdict

__all__ = ["STYLES", "verdict_results", "verdict_section", "verdict_text"]

TONES: dict[Use, Literal["good", "fair", "bad"]] = {Use.SIMULATION: "good", Use.CONTROL: "good", Use.DO_NOT_USE: "bad"}
STYLES = {use: "red" if tone == "bad" else "green" for use, tone in TONES.items()}  # in a terminal
SENTENCES = 3  # above the numbers
REASON = 110  # signs of a reason in a sentence of the page
FIRST_STEPS = 3  # in sight; the others are behind a fold
MOST_STEPS = 5  # besides remedies, in a terminal; the report has all


def verdict_text(identification: Identification) -> tuple[str, tuple[str, ...]]:
    """Return for a terminal the verdict in one paragraph, and the next steps: remedies, and the largest gains."""
    verdict = judge(identification)
    left = [one for one in verdict.next if not isinstance(one, Remedy)][MOST_STEPS:]
    steps = tuple(text for one, text in zip(verdict.next, _next_words(verdict), strict=True) if one not in left)
    more = (f"{len(left)} more, which the report lists.",) if left else ()
    return f"Verdict: {' '.join(sentences(verdict))}", (*steps, *more)


def verdict_section(
    identification: Identification, exports: Sequence[Export] = (), arm: Figure | None = None
) -> PageSection:
    """Return the verdict in three sentences and its numbers, beside them the ``arm``, where there is one, and the
    torque of the worst joint; what to do next, links to the files beside the report, and all reasons behind a fold."""
    verdict = judge(identification)
    steps, reasons = _next_words(verdict), tuple(map(words, verdict.reasons))
    said = sentences(verdict, REASON)
    numbers = Facts(tuple(head_numbers(identification)), large=True)
    pictures: tuple[PageBlock, ...] = (*filter(None, (arm,)), *_picture(identification))
    head: tuple[PageBlock, ...] = (*said[:SENTENCES], numbers, *export_links(exports))
    blocks: list[PageBlock] = list((Beside(head, pictures, "left"),) if pictures else head)
    if steps:
        more = (Fold(f"{len(steps) - FIRST_STEPS} more", (steps[FIRST_STEPS:],)),) if len(steps) > FIRST_STEPS else ()
        blocks.append(PageSection("What to do next", (steps[:FIRST_STEPS], *more)))
    blocks += said[SENTENCES:]
    if len(reasons) > IN_SENTENCES or max(map(len, reasons), default=0) > REASON:
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


def _picture(identification: Identification) -> tuple[PageBlock, ...]:
    """Return the torque of the worst joint on the log that is judged."""
    worst = worst_joint(identification)
    if worst is None:
        return ()
    (log, joint), several = worst, len(identification.model.joints) > 1
    unit = next(one.effort for one in identification.model.joints if one.name == joint)
    caption = f"{joint} on {log.name}, {number(log.errors.per_joint[joint], 3)} % error as measured."
    drawn = figures.glance_figure(log, joint, unit).of(label_of(log))
    torque = Figure(drawn, f"{'The worst joint: ' * several}{caption}")
    return (torque,)
