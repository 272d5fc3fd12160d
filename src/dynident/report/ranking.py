"""The words, tables and numbers of ``dynident compare``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from dynident.ranking import Outcome, mean_of
from dynident.report.check import finding_groups, finding_row
from dynident.report.page import Column, PageTable, number
from dynident.report.part_words import part_words
from dynident.report.words import count, listed, percent, short

if TYPE_CHECKING:
    from dynident.errors import Finding
    from dynident.ranking import Combination, Ranked, Ranking

__all__ = [
    "ends_of",
    "mark_of",
    "names_of",
    "ranking_dict",
    "ranking_findings",
    "ranking_heading",
    "ranking_tables",
    "with_words",
]

FEW = 10  # rows of a ranking in a terminal
NAMED = 4  # combinations that a sentence names
TINY = 1e-4  # share of an error that is shown as zero
LOW = 90.0  # % of the samples of a log in common, below which the smoother that leaves out most is looked for


def ranking_heading(found: Ranking) -> str:
    """Return what there is to say first."""
    best = found.best
    if best is None:
        return "none of the combinations has an estimate"
    return f"{with_words(best.combination)} predicts the torque best, with an error of {percent(best.error)}"


def with_words(one: Combination) -> str:
    """Return a combination in words."""
    return " with ".join(names_of(one))


def _basis(found: Ranking) -> str:
    return "held-out motion" if found.basis == "validation" else "stretches of the training, predicted from the others"


def ranking_findings(found: Ranking) -> tuple[str, ...]:
    """Return the comparison in sentences: which to take, what is as good, the configured one, what is missing."""
    parts = (_checked, _basis_lines, _chance_lines, _rival_lines, _own_lines, _truth_lines, _gaps)
    return tuple(line for part in parts for line in part(found))


def _checked(found: Ranking) -> Iterator[str]:
    """Yield what the checks have found that no ranking shows: a wrong robot file or log fits all combinations alike."""
    groups = finding_groups(found.forbidding)
    for group in groups[:NAMED]:
        yield f"Before any of them is used: {_found(group)}"
    if len(groups) > NAMED:
        yield f"{len(groups) - NAMED} more such findings: see `dynident check`."
    for group in finding_groups([one for one in found.findings if one not in found.forbidding])[:NAMED]:
        yield f"What simulates is as right as its controller: {_found(group)}"


def _found(group: Sequence[Finding]) -> str:
    return ": ".join(filter(None, finding_row(group)))


def _basis_lines(found: Ranking) -> Iterator[str]:
    if found.basis == "train" and found.best is not None:
        yield (
            "No log is held out, so that combinations are ranked by blocked cross-validation of the training: the same "
            "motion, which says less of others. Record another motion for `validation`."
        )
    for held, log in found.repeats:
        yield f"{held} repeats the motion of {log}, which holds nothing out: the order on another motion is not known."
    errors = {} if found.best is None else found.best.judged(found.basis)
    if unknown := [joint for joint, error in errors.items() if math.isnan(error)]:
        yield f"{listed(unknown, NAMED)}: no torque to compare with, and so left out of the mean over the joints."


def _chance_lines(found: Ranking) -> Iterator[str]:
    best, choice = found.best, found.choice
    if best is None:
        return
    if not found.told:
        yield (
            f"The logs are too short to tell differences from chance: they hold {short(found.blocks, 3)} blocks as "
            "long as the errors are correlated, and 12 are needed."
        )
    elif len(found.ranked) == 1:
        yield "There is no other to compare it with."
    elif len(found.within) == 1:
        yield "All others are worse by more than chance."
    else:
        others = [with_words(one.combination) for one in found.within[1:]]
        yield (
            f"{count(len(others), 'other')} of {len(found.ranked) - 1} {'is' if len(others) == 1 else 'are'} as good "
            f"within chance: {listed(others, NAMED)}."
        )
    if hardly := len(found.as_good) - len(found.within):
        yield (
            f"Of those that are worse, {hardly} {'is' if hardly == 1 else 'are'} so by less than 1 % of the error, "
            "which makes no difference in use."
        )
    if choice is None:
        return
    if choice is best:
        yield f"Take {with_words(choice.combination)}{_why_best(found)}."
    else:
        yield f"Take {with_words(choice.combination)} ({percent(choice.error)}): {_why(found)}."
    if not choice.physical:
        yield (
            "Its bodies are physically impossible (an eigenvalue below zero), as are those of all others as "
            "good: take a consistent estimator for simulation and control."
        )


def _rival_lines(found: Ranking) -> Iterator[str]:
    best, rival = found.best, found.rival
    if best is None or rival is None:
        return
    names = [with_words(one.combination) for one in (best, rival)]
    errors = [[percent(one.error), percent(mean_of(one.cross_validated))] for one in (best, rival)]
    yield (
        f"Held-out motion and cross-validation contradict each other: {names[0]} has {errors[0][0]} and "
        f"{errors[0][1]}, {names[1]} has {errors[1][0]} and {errors[1][1]}."
        + ("" if found.choice else " Take none of them before that is settled.")
    )
    same = mean_of(best.same_motion), mean_of(rival.same_motion)
    if rival.error > best.error and math.log(same[1] / same[0]) < 0.5 * math.log(rival.error / best.error):
        yield (
            f"On the held-out motion as the configured smoother has it, their parameters leave {percent(same[0])} and "
            f"{percent(same[1])}: the lead is in how {best.combination.smoother} sees the motion, not in its "
            "parameters. A shift in time does this (forward differences shift velocities by half a sample): look at "
            "the time offset, and at a `delay` that the configuration fixes."
        )


def _why_best(found: Ranking) -> str:
    best, others = found.best, found.as_good[1:]
    yours = ", as the configuration does" if best is found.own else ""
    faster = [one for one in others if best is not None and best.takes_longer(one.seconds)]
    if not others or best is None:
        why = ""
    elif not faster:
        why = ": none of these is much faster"
    elif not all(one.physical for one in faster):
        why = ": all of its bodies are possible, which those of faster ones are not"
    elif any(one.outcome is Outcome.UNSETTLED for one in faster):
        why = ": its iteration converged, which those of faster ones did not"
    else:
        why = ": cross-validation contradicts faster ones"
    return yours + why


def _why(found: Ranking) -> str:
    """Say why another than the best is to be taken."""
    best, choice = found.best, found.choice
    if best is None or choice is None:
        return ""
    good = "less than 1 % worse" if found.hardly_worse(choice) else "as good within chance"
    if not best.physical and choice.physical:
        return f"{good}, and all of its bodies are possible, which those of the best are not"
    if best.outcome is Outcome.UNSETTLED and choice.outcome is not Outcome.UNSETTLED:
        return f"{good}, and its iteration converged, which that of the best did not"
    if choice is found.own:
        return f"{good}, and nothing is to be changed"
    if found.rival is not None:
        return f"{good}, and not contradicted by cross-validation"
    return f"{good}, and takes {_time(choice.seconds)} instead of {_time(best.seconds)}"


def _time(seconds: float) -> str:
    return f"{short(seconds, 2)} s"


def _own_lines(found: Ranking) -> Iterator[str]:
    own, best = found.own, found.best
    if own is None or best is None or own is best:
        return
    name = f"The configuration's own, {with_words(own.combination)}"
    if math.isnan(own.error):
        yield f"{name}, has no estimate: {own.reason}"
        return
    place = found.ranked.index(own) + 1
    word = "worse by more than chance" if own.worse else "within chance of the best"
    word += ", but by less than 1 % of the error" if found.hardly_worse(own) else ""
    end = f", {word}" if found.told else ""
    yield f"{name}, is number {place} of {len(found.ranked)} with {percent(own.error)}{end}."


def _truth_lines(found: Ranking) -> Iterator[str]:
    known = [one for one in found.ranked if one.truth is not None and math.isfinite(one.truth.over_bound)]
    if not known:
        return
    near = min(known, key=lambda one: one.truth.over_bound if one.truth else math.inf)
    if near.truth is not None:
        yield (
            f"Nearest to the true base parameters is {with_words(near.combination)}: errors of "
            f"{short(near.truth.over_bound, 2)} times the least standard deviation that any unbiased method can reach "
            f"(rms), {near.truth.covered} of {near.truth.count} intervals of 95 % hold the truth."
        )
        if near.truth.count < len(near.truth.error):
            yield (
                f"Of {len(near.truth.error)} base parameters, {near.truth.count} have a true value and a standard "
                "error; the others lack one, or have parameters in them whose true value is not given."
            )


def _gaps(found: Ranking) -> Iterator[str]:
    for name in found.substituted:
        yield (
            f"{name} does not apply to all motion that is held out, where the default spline smooths in its place: its "
            "rows tell how good its parameters are, not its smoothing of that motion."
        )
    if found.ranked and min(found.shares.values()) < LOW:
        log = min(found.shares, key=lambda name: found.shares[name])
        most = min(found.kept, key=lambda name: found.kept[name])
        yield (
            f"Only {percent(found.shares[log])} of the samples of {log} count, those that all smoothers keep; {most} "
            f"keeps fewest, {percent(found.kept[most])} of all logs."
        )
    if found.failed:
        yield f"{count(len(found.failed), 'combination')} of {len(found.rows)} gave no estimate:"
        reasons = dict.fromkeys((one.reason, one.outcome.value) for one in found.failed)
        for reason, outcome in list(reasons)[:NAMED]:
            names = [with_words(one.combination) for one in found.failed if one.reason == reason]
            yield f"{listed(names, 2)} ({outcome}): {reason}"
        if len(reasons) > NAMED:
            yield f"{count(len(reasons) - NAMED, 'more reason')} in the report, and in what --json writes."
    for reason in dict.fromkeys(one.reason for one in found.absent):
        alike = [one for one in found.absent if one.reason == reason]
        names = [" with ".join(filter(None, (one.smoother, one.estimator))) for one in alike]
        yield f"Does not apply: {listed(names)}: {reason}"


def ranking_tables(found: Ranking) -> Iterator[PageTable]:
    """Yield the first rows for a terminal, with that of the configuration."""
    first = found.ranked[:FEW]
    own = found.own
    more = [own] if own is not None and own not in first and math.isfinite(own.error) else []
    if first:
        rows = tuple(_short_row(found, one) for one in (*first, *more))
        columns = (
            Column("smoother", numeric=False),
            Column("estimator", numeric=False),
            Column("error, %"),
            Column("from", "more than best"),
            Column("to", "more than best"),
            Column("s"),
            Column("", numeric=False),
        )
        left = len(found.ranked) - len(first)
        caption = f"Ranked by {_basis(found)}" + (f"; {left} more have larger errors" if left > 0 else "")
        yield PageTable(columns, rows, caption)


def _short_row(found: Ranking, one: Ranked) -> tuple[str, ...]:
    return (
        *names_of(one.combination), number(one.error, 3), *ends_of(found, one), number(one.seconds, 2),
        mark_of(found, one),
    )  # fmt: skip


def ends_of(found: Ranking, one: Ranked) -> tuple[str, str]:
    """Return the ends of the interval of the difference to the best; what is below 1e-4 of the error is zero."""
    if one is found.best:
        return "-", "-"
    low, high = (number(0.0 if abs(x) < TINY * one.error else x, 2) for x in one.interval)
    return low, high


def mark_of(found: Ranking, one: Ranked) -> str:
    """Return what there is to say of a combination in a word or two: whether it is the one to take, yours, worse."""
    words = ["take" if one is found.choice else "", "yours" if one.combination.own else ""]
    words.append(("hardly worse" if found.hardly_worse(one) else "worse") if one.worse else "")
    return ", ".join(filter(None, words))


def names_of(one: Combination) -> tuple[str, str]:
    """Return the names as they are shown: a line may be broken at a plus sign."""
    return one.smoother, one.estimator.replace("+", " + ")


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
        "kept_samples": dict(found.kept),
        "time_offsets": dict(found.offsets),
        "block_seconds": found.block,
        "blocks": found.blocks,
        "told_from_chance": found.told,
        "folds": found.folds,
        "findings": [_found(group) for group in finding_groups(found.findings)],
        "best": _pair(found.best),
        "take": _pair(found.choice),
        "contradicted_by": _pair(found.rival),
        "within_chance": [_pair(one) for one in found.within],
        "as_good": [_pair(one) for one in found.as_good],
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
    return None if one is None else list(names_of(one.combination))


def _row(found: Ranking, one: Ranked) -> dict[str, Any]:
    difference = math.nan if found.best is None else one.error - found.best.error
    row: dict[str, Any] = {
        "smoother": one.combination.smoother, "estimator": one.combination.estimator, "own": one.combination.own,
        "status": one.outcome.value, "reason": one.reason, "notes": list(one.notes), "error": one.error,
        "overall": one.overall,
        "difference": difference, "interval": list(one.interval), "p_value": one.p_value, "worse": one.worse,
        "held_out": dict(one.held_out), "same_motion": dict(one.same_motion), "training": dict(one.training),
        "cross_validated": dict(one.cross_validated), "condition": one.condition, "eigenvalue": one.eigenvalue,
        "cross_p_value": one.cross_p_value,
        "seconds": [one.seconds_smoothing, one.seconds_estimate, one.seconds_validation],
    }  # fmt: skip
    if one.truth is not None:
        row["truth"] = {
            "error": one.truth.error, "std": one.truth.std, "median_relative": one.truth.relative,
            "over_bound": one.truth.over_bound, "covered": one.truth.covered, "count": one.truth.count,
        }  # fmt: skip
    return row
