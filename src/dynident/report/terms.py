"""The choice of the terms beside the bodies, in a report, in a terminal, and beside the settings that repeat it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from dynident.identification import Outcome, Trial
from dynident.identification.terms.search import LEAST, STRICT, SURE
from dynident.io.families import TERMS
from dynident.report import figures
from dynident.report.page import Column, Figure, Fold, Gallery, PageSection, PageTable, number
from dynident.report.wording import words

if TYPE_CHECKING:
    from dynident.identification import Identification, TermChoice

__all__ = ["OUTCOMES", "choice_comments", "term_section", "term_table"]

OUTCOMES: Mapping[Outcome, str] = {
    Outcome.ENTERED: "entered",
    Outcome.TOO_SMALL: "refused: it gains too little",
    Outcome.WITHIN_ERROR: "refused: the gain is within its error",
    Outcome.REFUTED_FASTER: "refused: worse on faster motion",
    Outcome.REFUTED_FURTHER: "refused: worse further out than fitted",
    Outcome.REFUTED_BY_LOG: "refused: worse on another recording",
    Outcome.NEGATIVE: "refused: its coefficient would be negative",
    Outcome.NOT_EXCITED: "refused: the data do not show it",
    Outcome.REDUNDANT: "taken out again: the others do its work",
}
_LEAD = (
    "The terms of each joint were chosen on the training logs alone: each was tried beside those that had entered, by "
    "the torque error in stretches of time that were not fitted. The gain is what a term removes of the squared error "
    f"of its joint. A term enters where the gain is above {SURE:g} of its standard errors (a special one: {STRICT:g}) "
    f"and {LEAST:g} %, and where it is no loss on motion faster than fitted. To keep these terms, write them out: "
    "`dynident identify CONFIG --write-config FILE`."
)
_FIGURE = "With the plain set (offset, rotor inertia, viscous and Coulomb friction), the cross-validated error is"


def term_section(found: Identification) -> Iterator[PageSection]:
    """Yield the section on the terms, where they were chosen."""
    choice = found.calibration.terms
    if choice is None or not choice.trials:
        return
    views = tuple(
        ((joint,), (Figure(figures.trial_figure(_sorted(choice.of(joint)), OUTCOMES), _caption(choice, joint)),))
        for joint in choice.joints
        if choice.of(joint)
    )
    table = Fold("All that was tried", (_trials(choice),))
    yield PageSection("Friction and other terms", (_LEAD, term_table(choice), Gallery(("joint",), views), table))


def term_table(choice: TermChoice) -> PageTable:
    """Return one row per joint: the cross-validated errors, and the terms that entered with their gains."""
    columns = (
        Column("joint", numeric=False),
        Column("plain set, %"),
        Column("chosen, %"),
        Column("terms, and the gain of those that had to enter, % of the squared error", numeric=False, prose=True),
    )
    rows = []
    for joint, before, after in zip(choice.joints, choice.before, choice.after, strict=True):
        rows.append((joint, number(before, 3), number(after, 3), _listed(choice, joint)))
    return PageTable(columns, tuple(rows), "Terms chosen by the training logs, and their cross-validated torque error")


def choice_comments(found: Identification, source: str) -> dict[str, list[str]]:
    """Return the reasons for what was chosen as lines of comments, by key of a configuration; "" is of the whole."""
    calibration, recipe = found.calibration, found.recipe
    said = {
        "": [
            f"Written by `dynident identify {source} --write-config`: what was chosen there is named here, so that the",
            "result is the same. Numbers have all of their digits for that. The comments of that file are not kept.",
        ]
    }
    if (choice := calibration.terms) is not None:
        said["model.terms"] = [
            "chosen on the training logs; gains in % of the squared cross-validated error of the joint:",
            *(
                f"{joint}: {_listed(choice, joint)}; error {number(before, 3)} -> {number(after, 3)} %"
                for joint, before, after in zip(choice.joints, choice.before, choice.after, strict=True)
            ),
        ]
        if recipe.min_speed is not None:
            said["min_speed"] = ["rad/s or m/s: slower samples are left out of the fit of that joint"]
    if calibration.base_tilt is not None:
        said["model.base_tilt"] = [f"rad, about x and y: {words(calibration.base_tilt)}"]
    if calibration.time_offset is not None:
        said["delay"] = [f"s: {words(calibration.time_offset)}"]
    if calibration.prior_strength is not None:
        said["estimator"] = [f"strength of the prior: {words(calibration.prior_strength)}"]
    if calibration.smoother is not None:
        said["smoother"] = [f"{len(calibration.smoother.candidates)} were compared by the cross-validated torque error"]
    if recipe.rests == "trim":
        said["rests"] = ["at the ends; those within as cross-validation says, unless there is a min_speed"]
    return said


def _listed(choice: TermChoice, joint: str) -> str:
    """Return the terms of a joint, with their gains where they had to enter."""
    found = {TERMS.kind_of(one): "" for one in choice.terms if joint in getattr(one, "acts_on", choice.joints)}
    entered = [one for one in choice.of(joint) if one.outcome is Outcome.ENTERED]
    found |= {one.kind: f" {_gain(one.gain, one.std)}" for one in entered}
    return ", ".join(f"{kind}{gain}" for kind, gain in found.items()) or "none"


def _sorted(trials: Sequence[Trial]) -> list[Trial]:
    """Return trials as a reader looks for them: those that entered first, then by their gain."""
    return sorted(trials, key=lambda one: (one.outcome is not Outcome.ENTERED, -one.gain))


def _caption(choice: TermChoice, joint: str) -> str:
    k = choice.joints.index(joint)
    return f"{joint}: {_FIGURE} {number(choice.before[k], 3)} %, with the terms chosen {number(choice.after[k], 3)} %."


def _trials(choice: TermChoice) -> PageTable:
    words_of = (Column("joint", numeric=False), Column("term", numeric=False), Column("constants", numeric=False))
    gains = (Column("gain, %"), Column("std. error"), Column("on faster motion, %"), Column("std. error"))
    columns = (*words_of, *gains, Column("outcome", numeric=False, prose=True))
    rows = [
        (
            joint,
            one.kind,
            ", ".join(f"{name} {_value(value)}" for name, value in one.settings) or "-",
            *(number(gain, 3) for gain in (one.gain, one.std, one.faster, one.faster_std)),
            OUTCOMES[one.outcome],
        )
        for joint in choice.joints
        for one in _sorted(choice.of(joint))
    ]
    return PageTable(columns, tuple(rows), "Gain, in % of the squared cross-validated error of the joint")


def _gain(gain: float, std: float | None) -> str:
    return f"{number(gain, 3)} +- {number(std, 2)}"


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return " and ".join(map(_value, value))
    return number(value, 3) if isinstance(value, float) else str(value)
