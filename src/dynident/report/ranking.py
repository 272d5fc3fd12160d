"""The words, tables and page of ``dynident compare``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dynident.report import figures
from dynident.report.page import (
    Badge,
    Column,
    Facts,
    Figure,
    Fold,
    PageBlock,
    PageSection,
    PageTable,
    number,
    render,
)
from dynident.report.part_words import part_words
from dynident.report.words import count, huge, listed, percent, short

if TYPE_CHECKING:
    from dynident.ranking import Combination, Ranked, Ranking

__all__ = ["ranking_dict", "ranking_findings", "ranking_heading", "ranking_page", "ranking_tables"]

FEW = 10  # rows of a ranking in a terminal
NAMED = 4  # combinations that a sentence names
LOW = 90.0  # % of the samples of a log in common, below which the smoother that leaves out most is looked for
METHOD = (
    "Terms of the model, time offset, tilt of the base and what of the logs is fitted were chosen once, by the "
    "configuration's own recipe; only smoother and estimator differ. All are fitted and judged on the samples that all "
    "smoothers keep, against the unfiltered torque. The torque of a held-out log is predicted from its positions as the "
    "same smoother sees them; “same motion” is the error with the motion of the configured smoother, in which only the "
    "parameters differ. In cross-validation, stretches of the training are predicted from the others.",
    "Differences are told from chance by drawing blocks of time anew, the same ones for all (paired block bootstrap); "
    "the blocks are as long as the differences are correlated. A combination is called worse only where it is worse than "
    "another by more than the largest of all its differences is by chance (Hsu, 1981), so that those within chance of "
    "the best hold the truly best one with 95 %, though the best was chosen by the data. This is about motions like the "
    "held-out ones: of another motion nothing is known.",
    "Seconds are those of this computer, with one thread: the smoothing of all logs, and the estimate with its "
    "correction of the bias by errors of the motion. Conditions are of the scaled regressor. The smallest eigenvalue of "
    "the pseudo-inertias is relative to the usual size of a body: below zero, a body is impossible.",
)


def ranking_heading(found: Ranking) -> str:
    """Return what there is to say first."""
    best = found.best
    if best is None:
        return "none of the combinations has an estimate"
    return f"{_with(best.combination)} predicts the torque best, with an error of {percent(best.error)}"


def _with(one: Combination) -> str:
    return f"{one.smoother} with {one.estimator}"


def _basis(found: Ranking) -> str:
    return "held-out motion" if found.basis == "validation" else "stretches of the training, predicted from the others"


def ranking_findings(found: Ranking) -> tuple[str, ...]:
    """Return the comparison in sentences: which to take, what is as good, the configured one, what is missing."""
    return (*_basis_lines(found), *_chance_lines(found), *_own_lines(found), *_truth_lines(found), *_gaps(found))


def _basis_lines(found: Ranking) -> Iterator[str]:
    if found.basis == "train" and found.best is not None:
        yield (
            "No log is held out, so that combinations are ranked by blocked cross-validation of the training: the same "
            "motion, which says less of others. Record another motion for `validation`."
        )


def _chance_lines(found: Ranking) -> Iterator[str]:
    best, choice = found.best, found.choice
    if best is None or choice is None:
        return
    if not found.told:
        yield (
            f"The logs are too short to tell differences from chance: they hold {short(found.blocks, 2)} blocks as long "
            "as the errors are correlated, and 10 are needed."
        )
    elif len(found.within) == 1:
        yield "All others are worse by more than chance."
    else:
        others = [_with(one.combination) for one in found.within[1:]]
        yield (
            f"{count(len(others), 'other')} of {len(found.ranked) - 1} {'is' if len(others) == 1 else 'are'} as good "
            f"within chance: {listed(others, NAMED)}."
        )
    if choice is best:
        yield f"Take {_with(choice.combination)}{_why_best(found)}."
    else:
        yield f"Take {_with(choice.combination)} ({percent(choice.error)}): {_why(found)}."
    if not choice.physical:
        yield (
            "Its bodies are physically impossible (an eigenvalue below zero), as are those of all others within chance: "
            "take a consistent estimator for simulation and control."
        )


def _why_best(found: Ranking) -> str:
    return ", the fastest of these with the least error" if len(found.within) > 1 else ""


def _why(found: Ranking) -> str:
    """Say why another than the best is to be taken."""
    best, choice = found.best, found.choice
    if best is None or choice is None:
        return ""
    faster = f"as good within chance, and takes {_time(choice.seconds)} instead of {_time(best.seconds)}"
    if not best.physical and choice.physical:
        faster = "as good within chance, and all of its bodies are possible, which those of the best are not"
    return faster


def _time(seconds: float) -> str:
    return f"{short(seconds, 2)} s"


def _own_lines(found: Ranking) -> Iterator[str]:
    own, best = found.own, found.best
    if own is None or best is None or own is best:
        if own is not None and own is best:
            yield "That is the combination of the configuration."
        return
    name = f"The configuration's own, {_with(own.combination)}"
    if math.isnan(own.error):
        yield f"{name}, has no estimate: {own.reason}"
        return
    place = found.ranked.index(own) + 1
    word = "worse by more than chance" if own.worse else "within chance of the best"
    end = f", {word}" if found.told else ""
    yield f"{name}, is number {place} of {len(found.ranked)} with {percent(own.error)}{end}."


def _truth_lines(found: Ranking) -> Iterator[str]:
    known = [one for one in found.ranked if one.truth is not None and math.isfinite(one.truth.over_bound)]
    if not known:
        return
    near = min(known, key=lambda one: one.truth.over_bound if one.truth else math.inf)
    if near.truth is not None:
        yield (
            f"Nearest to the true base parameters is {_with(near.combination)}: errors of "
            f"{short(near.truth.over_bound, 2)} times the least standard deviation that any unbiased method can reach "
            f"(rms), {near.truth.covered} of {near.truth.count} intervals of 95 % hold the truth."
        )


def _gaps(found: Ranking) -> Iterator[str]:
    if found.ranked and min(found.shares.values()) < LOW:
        log = min(found.shares, key=lambda name: found.shares[name])
        yield f"Only {percent(found.shares[log])} of the samples of {log} are kept by all smoothers; fewer keep more."
    if found.failed:
        yield f"{count(len(found.failed), 'combination')} of {len(found.rows)} gave no error:"
        reasons = dict.fromkeys((one.reason, one.outcome.value) for one in found.failed)
        for reason, outcome in list(reasons)[:NAMED]:
            names = [_with(one.combination) for one in found.failed if one.reason == reason]
            yield f"{listed(names, 2)} ({outcome}): {reason}"
    for one in found.absent:
        name = " with ".join(filter(None, (one.smoother, one.estimator)))
        yield f"Does not apply: {name}: {one.reason}"


def ranking_tables(found: Ranking) -> Iterator[PageTable]:
    """Yield the first rows for a terminal, with that of the configuration."""
    first = found.ranked[:FEW]
    own = found.own
    more = [own] if own is not None and own not in first and math.isfinite(own.error) else []
    if first:
        rows = tuple(_short_row(found, one) for one in (*first, *more))
        columns = (
            Column("", numeric=True),
            Column("smoother", numeric=False),
            Column("estimator", numeric=False),
            Column("error, %"),
            Column("more than best", "95 % of difference"),
            Column("to", "95 % of difference"),
            Column("s"),
            Column("", numeric=False),
        )
        left = len(found.ranked) - len(first)
        caption = f"Ranked by {_basis(found)}" + (f"; {left} more have larger errors" if left > 0 else "")
        yield PageTable(columns, rows, caption)


def _short_row(found: Ranking, one: Ranked) -> tuple[str, ...]:
    low, high = ("-", "-") if one is found.best else (number(x, 2) for x in one.interval)
    return (
        str(found.ranked.index(one) + 1), one.combination.smoother, one.combination.estimator, number(one.error, 3),
        low, high, number(one.seconds, 2), _mark(found, one),
    )  # fmt: skip


def _mark(found: Ranking, one: Ranked) -> str:
    words = ["take" if one is found.choice else "", "yours" if one.combination.own else ""]
    words.append("worse" if one.worse else "")
    return ", ".join(filter(None, words))


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
        sections.append(PageSection("Without an error", tuple(_without(found))))
    sections.append(PageSection("How it is compared", (*METHOD, _parts_table(found))))
    lead = f"{count(len(found.rows), 'combination')} on {found.name}: {ranking_heading(found)}."
    return render("Smoothers and estimators compared", lead, sections)


def _badge(found: Ranking) -> Badge | None:
    own = found.own
    if own is None or not found.ranked:
        return Badge("no error", "bad") if not found.ranked else None
    if own in found.within:
        return Badge("yours is among the best", "good")
    return Badge("others are better", "fair") if found.told else None


def _first(found: Ranking) -> Iterator[PageBlock]:
    best, choice, own = found.best, found.choice, found.own
    facts: list[tuple[str, ...]] = []
    if choice is not None:
        facts.append((percent(choice.error), "torque error of the one to take", _with(choice.combination)))
    if best is not None and best is not choice:
        facts.append((percent(best.error), "least torque error", _with(best.combination)))
    if own is not None and own is not choice and own is not best and math.isfinite(own.error):
        facts.append((percent(own.error), "error of the configuration's own", _with(own.combination)))
    if found.told:
        facts.append((str(len(found.within)), "within chance of the best", f"of {len(found.ranked)} with an error"))
    if facts:
        yield Facts(tuple(facts))
    yield ranking_findings(found)


def _figures(found: Ranking) -> Iterator[PageBlock]:
    told = (
        " The line through a mark is the 95 % interval of its difference to the best, whose error is the dashed line; "
        "open marks are worse by more than chance."
        if found.told
        else ""
    )
    what = "on held-out motion" if found.basis == "validation" else "in cross-validation"
    yield Figure(
        figures.ranking_figure(found),
        f"Torque error {what}, mean over joints, by estimator; the best of each comes first.{told}",
    )
    yield Figure(figures.cost_figure(found), "The same errors over what they cost; the ring is the one to take.")


def _whole_table(found: Ranking) -> PageTable:
    columns = [
        Column(""), Column("smoother", numeric=False), Column("estimator", numeric=False), Column("error, %"),
        Column("from", "95 % of difference"), Column("to", "95 % of difference"), Column("", numeric=False),
        Column("same motion, %"), Column("cross-validated, %"), Column("training, %"), Column("condition"),
        Column("eigenvalue"), Column("smoothing", "seconds"), Column("estimate", "seconds"),
    ]  # fmt: skip
    rows = []
    for k, one in enumerate(found.ranked, start=1):
        low, high = ("-", "-") if one is found.best else (number(x, 2) for x in one.interval)
        means = (_mean(one.same_motion), _mean(one.cross_validated), _mean(one.training))
        rows.append(
            (
                str(k), one.combination.smoother, one.combination.estimator, number(one.error), low, high,
                _mark(found, one), *(number(value, 3) for value in means), huge(one.condition),
                number(one.eigenvalue, 2), number(one.seconds_smoothing, 2), number(one.seconds_estimate, 2),
            )
        )  # fmt: skip
    return PageTable(tuple(columns), tuple(rows), "Relative torque errors, mean over joints")


def _mean(by_joint: Mapping[str, float]) -> float:
    from dynident.ranking.ranking import mean_of

    return mean_of(by_joint)


def _joint_table(found: Ranking) -> PageTable:
    columns = (Column("smoother", numeric=False), Column("estimator", numeric=False), *map(Column, found.joints))
    rows = []
    for one in found.ranked:
        errors = one.held_out if found.basis == "validation" else one.cross_validated
        cells = (number(errors.get(joint), 3) for joint in found.joints)
        rows.append((one.combination.smoother, one.combination.estimator, *cells))
    what = "on held-out motion" if found.basis == "validation" else "in cross-validation"
    return PageTable(columns, tuple(rows), f"Relative torque error {what} by joint, %")


def _truth_blocks(found: Ranking) -> Iterator[PageBlock]:
    columns = (
        Column("smoother", numeric=False), Column("estimator", numeric=False), Column("error, median %"),
        Column("error, in bounds (rms)"), Column("intervals that hold it"), Column("of"),
    )  # fmt: skip
    rows = [
        (
            one.combination.smoother, one.combination.estimator, number(one.truth.relative, 3),
            number(one.truth.over_bound, 3), str(one.truth.covered), str(one.truth.count),
        )
        for one in found.ranked
        if one.truth is not None
    ]  # fmt: skip
    yield (
        "Errors of the base parameters whose truth is known, in % of it and in units of the least standard deviation that "
        "any unbiased method can reach on these logs (about 1 where it is reached: one recording shows bias and spread "
        "together), and how many of the 95 % intervals hold the truth."
    )
    yield PageTable(columns, tuple(rows), "Base parameters against the truth")
    detail = [one for one in dict.fromkeys((found.choice, found.best, found.own)) if one is not None and one.truth]
    for one in detail:
        yield Fold(f"Base parameters of {_with(one.combination)}", (_base_table(found, one),))


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
    rows = [(*_names(one.combination), one.outcome.value, one.reason) for one in found.failed]
    rows += [(one.smoother or "any", one.estimator or "any", "does not apply", one.reason) for one in found.absent]
    yield PageTable(columns, tuple(rows), "Combinations without an error, and why")


def _names(one: Combination) -> tuple[str, str]:
    return one.smoother, one.estimator


def _parts_table(found: Ranking) -> PageTable:
    rows = [("smoother", one.name, part_words(one.part)) for one in found.smoothers]
    rows += [("estimator", one.name, part_words(one.part)) for one in found.estimators]
    columns = (Column("", numeric=False), Column("name", numeric=False), Column("settings", numeric=False, prose=True))
    return PageTable(columns, tuple(rows), "What was compared")


def ranking_dict(found: Ranking) -> dict[str, Any]:
    """Return a comparison as plain values, for JSON."""
    return {
        "format": "dynident ranking",
        "version": 1,
        "name": found.name,
        "sentences": [ranking_heading(found), *ranking_findings(found)],
        "ranked_by": "held-out logs" if found.basis == "validation" else "cross-validation",
        "joints": list(found.joints),
        "common_samples": dict(found.shares),
        "block_seconds": found.block,
        "blocks": found.blocks,
        "told_from_chance": found.told,
        "folds": found.folds,
        "best": _pair(found.best),
        "take": _pair(found.choice),
        "within_chance": [_pair(one) for one in found.within],
        "parts": {
            family: [{"name": one.name, "own": one.own, "settings": part_words(one.part)} for one in parts]
            for family, parts in (("smoothers", found.smoothers), ("estimators", found.estimators))
        },
        "rows": [_row(found, one) for one in found.rows],
        "does_not_apply": [
            {"smoother": one.smoother, "estimator": one.estimator, "reason": one.reason} for one in found.absent
        ],
        "base_parameters": list(found.parameters),
    }


def _pair(one: Ranked | None) -> list[str] | None:
    return None if one is None else list(_names(one.combination))


def _row(found: Ranking, one: Ranked) -> dict[str, Any]:
    difference = math.nan if found.best is None else one.error - found.best.error
    row: dict[str, Any] = {
        "smoother": one.combination.smoother, "estimator": one.combination.estimator, "own": one.combination.own,
        "status": one.outcome.value, "reason": one.reason, "notes": list(one.notes), "error": one.error,
        "difference": difference, "interval": list(one.interval), "p_value": one.p_value, "worse": one.worse,
        "held_out": dict(one.held_out), "same_motion": dict(one.same_motion), "training": dict(one.training),
        "cross_validated": dict(one.cross_validated), "condition": one.condition, "eigenvalue": one.eigenvalue,
        "seconds": [one.seconds_smoothing, one.seconds_estimate, one.seconds_validation],
    }  # fmt: skip
    if one.truth is not None:
        row["truth"] = {
            "error": one.truth.error, "std": one.truth.std, "median_relative": one.truth.relative,
            "over_bound": one.truth.over_bound, "covered": one.truth.covered, "count": one.truth.count,
        }  # fmt: skip
    return row
