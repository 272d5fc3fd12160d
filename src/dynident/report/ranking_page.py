"""The page of ``dynident compare``: which to take, errors with what they cost, all combinations, by joint, methods."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from dynident.errors import shortened
from dynident.ranking import mean_of
from dynident.report import figures
from dynident.report.page import Badge, Column, Facts, Figure, Fold, PageBlock, PageSection, PageTable, number, render
from dynident.report.part_words import part_words
from dynident.report.ranking import ends_of, mark_of, names_of, ranking_findings, ranking_heading, with_words
from dynident.report.words import count, huge, percent, short

if TYPE_CHECKING:
    from dynident.ranking import Ranked, Ranking

__all__ = ["ranking_page"]

NAME = 16  # letters of a joint above its column
SAME = (
    "Terms of the model, tilt of the base and what of the logs is fitted were chosen once, by the configuration's own "
    "recipe; only smoother and estimator differ. A time offset that is estimated is so for each smoother. All are "
    "fitted and judged on the samples that all smoothers keep, against the unfiltered torque. The torque of a held-out "
    'log is predicted from its positions as the same smoother sees them; "same motion" is the error with the motion of '
    "the configured smoother, in which only the parameters differ. Errors are geometric means over the joints of their "
    "relative errors: one percent less in any joint counts the same, however much torque it has, as in the likelihood "
    'of residuals of each joint\'s own size; "all joints" is the error of all torques together, as `identify` has it. '
    "In cross-validation, stretches of the training are predicted from the others. A wrong robot file is fitted by all "
    "alike, and a wrong factor of all torques shows in no error: the verdict of `dynident identify` counts more."
)
CHANCE = (
    "Differences are told from chance by drawing blocks of time anew, the same ones for all (paired block bootstrap); "
    "the blocks are as long as the differences are correlated{length}. A combination is called worse only where it is "
    "worse than another by more than the largest of all its differences is by chance (Hsu, 1981), so that those within "
    "chance of the best hold the truly best one with 95 %, though the best was chosen by the data. This is about "
    "motions like the held-out ones: of another motion nothing is known."
)
COSTS = (
    "Seconds are those of this computer, with one thread: the smoothing of all logs, and the estimate with its "
    "correction of the bias by errors of the motion. Conditions are of the scaled regressor, in what the data "
    "determine. The smallest eigenvalue of the pseudo-inertias is relative to the usual size of a body: below zero, a "
    "body is impossible."
)


def ranking_page(found: Ranking) -> str:
    """Return the comparison as one HTML page."""
    sections = [PageSection("Which to take", tuple(_first(found)), _badge(found))]
    if found.ranked:
        sections.append(PageSection("Errors", tuple(_figures(found))))
        sections.append(PageSection("All combinations", (_whole_table(found),)))
        sections.append(PageSection("By joint", (_joint_table(found),)))
    if any(one.truth is not None for one in found.ranked):
        sections.append(PageSection("Against the truth", tuple(_truth_blocks(found))))
    if found.failed or found.absent:
        sections.append(PageSection("Without an estimate", tuple(_without(found))))
    sections.append(PageSection("How it is compared", (SAME, _chance(found), COSTS, _parts_table(found))))
    lead = f"{count(len(found.rows), 'combination')} on {found.name}: {ranking_heading(found)}."
    return render("Smoothers and estimators compared", lead, sections)


def _badge(found: Ranking) -> Badge | None:
    own = found.own
    if own is None or not found.ranked:
        return Badge("no estimate", "bad") if not found.ranked else None
    if found.forbidding:
        return Badge("correct first what was found", "bad")
    if found.rival is not None:
        return Badge("contradicted by cross-validation", "fair")
    if own in found.as_good:
        return Badge("yours is among the best", "good")
    return Badge("others are better", "fair") if found.told else None


def _first(found: Ranking) -> Iterator[PageBlock]:
    best, choice, own = found.best, found.choice, found.own
    facts: list[tuple[str, ...]] = []
    if choice is not None:
        facts.append((percent(choice.error), "torque error of the one to take", with_words(choice.combination)))
    if best is not None and best is not choice:
        facts.append((percent(best.error), "least torque error", with_words(best.combination)))
    if own is not None and own is not choice and own is not best and math.isfinite(own.error):
        facts.append((percent(own.error), "error of the configuration's own", with_words(own.combination)))
    if found.told:
        facts.append((str(len(found.within)), "within chance of the best", f"of {len(found.ranked)} with an error"))
    if facts:
        yield Facts(tuple(facts))
    yield ranking_findings(found)


def _figures(found: Ranking) -> Iterator[PageBlock]:
    told = (
        " The line through a mark is the 95 % interval of its difference to the best, whose error is the dashed line; "
        "open marks are worse by more than chance, which counts that the best was chosen among many."
        if found.told
        else ""
    )
    what = "on held-out motion" if found.basis == "validation" else "in cross-validation"
    yield Figure(
        figures.ranking_figure(found),
        f"Torque error {what}, geometric mean over joints, by estimator; the best of each comes first.{told}",
    )
    yield Figure(figures.cost_figure(found), "The same errors over what they cost; the ring is the one to take.")


def _whole_table(found: Ranking) -> PageTable:
    columns = [
        Column("smoother", numeric=False), Column("estimator", numeric=False), Column("", numeric=False),
        Column("error, %"), Column("from", "more than best, 95 %"), Column("to", "more than best, 95 %"),
        Column("all joints, %"), Column("same motion, %"), Column("cross-validated, %"), Column("training, %"),
        Column("condition"), Column("eigenvalue"), Column("seconds"),
    ]  # fmt: skip
    rows = []
    for one in found.ranked:
        means = (one.overall, mean_of(one.same_motion), mean_of(one.cross_validated), mean_of(one.training))
        names = (*names_of(one.combination), mark_of(found, one))
        errors = (number(one.error), *ends_of(found, one), *(number(value, 3) for value in means))
        rows.append((*names, *errors, huge(one.condition), number(one.eigenvalue, 2), number(one.seconds, 2)))
    return PageTable(tuple(columns), tuple(rows), "Relative torque errors, geometric mean over joints")


def _joint_table(found: Ranking) -> PageTable:
    joints = (Column(name) for name in shortened(found.joints, NAME))
    columns = (Column("smoother", numeric=False), Column("estimator", numeric=False), *joints)
    rows = []
    for one in found.ranked:
        errors = one.judged(found.basis)
        cells = (number(errors.get(joint), 3) for joint in found.joints)
        rows.append((*names_of(one.combination), *cells))
    what = "on held-out motion" if found.basis == "validation" else "in cross-validation"
    return PageTable(columns, tuple(rows), f"Relative torque error {what} by joint, %")


def _truth_blocks(found: Ranking) -> Iterator[PageBlock]:
    columns = (
        Column("smoother", numeric=False), Column("estimator", numeric=False), Column("error, median %"),
        Column("error, in bounds (rms)"), Column("intervals that hold it"), Column("of"),
    )  # fmt: skip
    rows = [
        (
            *names_of(one.combination), number(one.truth.relative, 3),
            number(one.truth.over_bound, 3), str(one.truth.covered), str(one.truth.count),
        )
        for one in found.ranked
        if one.truth is not None
    ]  # fmt: skip
    yield (
        "Errors of the base parameters whose truth is known, in % of it and in units of the least standard deviation "
        "that any unbiased method can reach on these logs (about 1 where it is reached: one recording shows bias and "
        "spread together), and how many of the 95 % intervals hold the truth."
    )
    yield PageTable(columns, tuple(rows), "Base parameters against the truth")
    detail = [one for one in dict.fromkeys((found.choice, found.best, found.own)) if one is not None and one.truth]
    for one in detail:
        yield Fold(f"Base parameters of {with_words(one.combination)}", (_base_table(found, one),))


def _base_table(found: Ranking, one: Ranked) -> PageTable:
    columns = (Column("base parameter", numeric=False), Column("error"), Column("std"), Column("unit", numeric=False))
    if one.truth is None:
        return PageTable(columns, ())
    pairs = zip(found.parameters, one.truth.error.tolist(), one.truth.std.tolist(), found.units, strict=True)
    return PageTable(columns, tuple((name, number(e, 3), number(s, 2), unit) for name, e, s, unit in pairs))


def _without(found: Ranking) -> Iterator[PageBlock]:
    columns = (
        Column("smoother", numeric=False), Column("estimator", numeric=False), Column("status", numeric=False),
        Column("reason", numeric=False, prose=True),
    )  # fmt: skip
    rows = [(*names_of(one.combination), one.outcome.value, one.reason) for one in found.failed]
    rows += [(one.smoother or "any", one.estimator or "any", "does not apply", one.reason) for one in found.absent]
    yield PageTable(columns, tuple(rows), "Combinations without an error, and why")


def _chance(found: Ranking) -> str:
    return CHANCE.format(length=f", {short(found.block, 2)} s" if math.isfinite(found.block) else "")


def _parts_table(found: Ranking) -> PageTable:
    late = {name: f"; time offset {short(1000 * seconds, 3)} ms" for name, seconds in found.offsets.items() if seconds}
    rows = [("smoother", one.name, part_words(one.part) + late.get(one.name, "")) for one in found.smoothers]
    rows += [("estimator", one.name, part_words(one.part)) for one in found.estimators]
    columns = (Column("", numeric=False), Column("name", numeric=False), Column("settings", numeric=False, prose=True))
    return PageTable(columns, tuple(rows), "What was compared")
