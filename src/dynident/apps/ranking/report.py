"""Sentences, tables and numbers of ``dynident compare``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from dynident.apps.ranking.ranking import CombinationOutcome, RankedCombination, Ranking, geometric_mean
from dynident.report.check import finding_groups
from dynident.report.page import Column, PageTable
from dynident.runtime import Finding, count, join_names, number, part_text, percent, place_and_text, short

MAX_ROWS, MAX_FINDINGS = 3, 2  # rows and sentences of a ranking in a terminal
MAX_NAMED = 4  # combinations that a sentence names
MIN_SHOWN_RATIO = 1e-4  # share of an error that is shown as zero
# % of the samples of a log in common, below which the smoother that leaves out most is looked for
MIN_COMMON_PERCENT = 90.0


def ranking_heading(ranking: Ranking) -> str:
    """Return the headline: which combination predicts the torque best."""
    best = ranking.best
    if best is None:
        return "none of the combinations has an estimate"
    errors = f"mean joint error {percent(best.error)}, torque error {percent(best.overall)}"
    return f"{best.combination} predicts the torque best: {errors}"


def ranking_findings(ranking: Ranking) -> tuple[str, ...]:
    """Return the comparison in sentences: which to take, equally good ones, the configured one, what is missing."""
    parts = (_check_lines, _basis_lines, _chance_lines, _rival_lines, _configured_lines, _truth_lines, _gap_lines)
    return tuple(line for part in parts for line in part(ranking))


def _check_lines(ranking: Ranking) -> Iterator[str]:
    """Yield the findings of the checks that no ranking shows, as a wrong file or log harms all combinations alike."""
    groups = finding_groups(ranking.forbidding_findings)
    for group in groups[:MAX_NAMED]:
        yield f"Before any of them is used: {_finding_text(group)}"
    if len(groups) > MAX_NAMED:
        yield f"{len(groups) - MAX_NAMED} more such findings: see `dynident check`."
    others = [finding for finding in ranking.findings if finding not in ranking.forbidding_findings]
    for group in finding_groups(others)[:MAX_NAMED]:
        yield f"What simulates is as right as its controller: {_finding_text(group)}"


def _finding_text(group: Sequence[Finding]) -> str:
    return ": ".join(filter(None, place_and_text(group)))


def _basis_lines(ranking: Ranking) -> Iterator[str]:
    if ranking.basis == "train" and ranking.best is not None:
        yield (
            "No log is held out, so that combinations are ranked by blocked cross-validation of the training: the same "
            "motion, which says less of others. Record another motion for `validation`."
        )
    for name, log in ranking.repeats:
        yield f"{name} repeats the motion of {log}, which holds nothing out: the order on another motion is not known."
    errors = {} if ranking.best is None else ranking.best.ranking_errors(ranking.basis)
    if unknown := [joint for joint, error in errors.items() if math.isnan(error)]:
        names = join_names(unknown, MAX_NAMED)
        yield f"{names}: no torque to compare with, and so left out of the mean over the joints."


def _chance_lines(ranking: Ranking) -> Iterator[str]:
    best, choice = ranking.best, ranking.choice
    if best is None:
        return
    if not ranking.has_enough_blocks:
        yield (
            f"The logs are too short to tell differences from chance: they hold {short(ranking.blocks, 3)} blocks as "
            "long as the errors are correlated, and 12 are needed."
        )
    elif len(ranking.standings) == 1:
        yield "There is no other to compare it with."
    elif len(ranking.within_chance) == 1:
        yield "All others are worse by more than chance."
    else:
        peers = [str(row.combination) for row in ranking.within_chance[1:]]
        yield (
            f"{count(len(peers), 'other')} of {len(ranking.standings) - 1} {'is' if len(peers) == 1 else 'are'} as "
            f"good within chance: {join_names(peers, MAX_NAMED)}."
        )
    if hardly := len(ranking.as_good) - len(ranking.within_chance):
        yield (
            f"Of those that are worse, {hardly} {'is' if hardly == 1 else 'are'} so by less than 1 % of the error, "
            "which makes no difference in use."
        )
    if choice is None:
        return
    if choice is best:
        yield f"Take {choice.combination}{_best_reason(ranking)}."
    else:
        yield f"Take {choice.combination} ({percent(choice.error)}): {_choice_reason(ranking)}."
    if not choice.is_physical:
        possible = next((row for row in ranking.standings if row.eigenvalue is not None and row.is_physical), None)
        remedy = (
            ", as are those of all others: take a consistent estimator for simulation and control."
            if possible is None
            else f": for simulation and control take {possible.combination} ({percent(possible.error)}), "
            "the best whose bodies are possible."
        )
        yield f"Its bodies are physically impossible (an eigenvalue below zero){remedy}"


def _rival_lines(ranking: Ranking) -> Iterator[str]:
    best, rival = ranking.best, ranking.rival
    if best is None or rival is None:
        return
    names = [str(row.combination) for row in (best, rival)]
    errors = [[percent(row.error), percent(geometric_mean(row.cross_validated))] for row in (best, rival)]
    yield (
        f"Held-out motion and cross-validation contradict each other: {names[0]} has {errors[0][0]} and "
        f"{errors[0][1]}, {names[1]} has {errors[1][0]} and {errors[1][1]}."
        + ("" if ranking.choice else " Take none of them before that is settled.")
    )
    # Parameters that are as good on the same motion show that the smoothing makes the difference
    means = geometric_mean(best.same_motion), geometric_mean(rival.same_motion)
    if rival.error > best.error and math.log(means[1] / means[0]) < 0.5 * math.log(rival.error / best.error):
        yield (
            f"On the held-out motion as the configured smoother has it, their parameters leave {percent(means[0])} and "
            f"{percent(means[1])}: the lead is in how {best.combination.smoother} sees the motion, not in its "
            "parameters. A shift in time does this (forward differences shift velocities by half a sample): look at "
            "the time offset, and at a `time_offset` that the configuration fixes."
        )


def _best_reason(ranking: Ranking) -> str:
    best, alternatives = ranking.best, ranking.as_good[1:]
    yours = ", as the configuration does" if best is ranking.configured_entry else ""
    faster = [row for row in alternatives if best is not None and best.takes_longer(row.seconds)]
    if not alternatives or best is None:
        why = ""
    elif not faster:
        why = ": none of these is much faster"
    elif not all(row.is_physical for row in faster):
        why = ": all of its bodies are possible, which those of faster ones are not"
    elif any(row.outcome is CombinationOutcome.UNSETTLED for row in faster):
        why = ": its iteration converged, which those of faster ones did not"
    else:
        why = ": cross-validation contradicts faster ones"
    return yours + why


def _choice_reason(ranking: Ranking) -> str:
    """Return why another combination than the best is to be taken."""
    best, choice = ranking.best, ranking.choice
    if best is None or choice is None:
        return ""
    good = "less than 1 % worse" if ranking.hardly_worse(choice) else "as good within chance"
    if not best.is_physical and choice.is_physical:
        return f"{good}, and all of its bodies are possible, which those of the best are not"
    if best.outcome is CombinationOutcome.UNSETTLED and choice.outcome is not CombinationOutcome.UNSETTLED:
        return f"{good}, and its iteration converged, which that of the best did not"
    if choice is ranking.configured_entry:
        return f"{good}, and nothing is to be changed"
    if ranking.rival is not None:
        return f"{good}, and not contradicted by cross-validation"
    return f"{good}, and takes {_seconds_text(choice.seconds)} instead of {_seconds_text(best.seconds)}"


def _seconds_text(seconds: float) -> str:
    return f"{short(seconds, 2)} s"


def _configured_lines(ranking: Ranking) -> Iterator[str]:
    configured, best = ranking.configured_entry, ranking.best
    if configured is None or best is None or configured is best:
        return
    name = f"The configuration's own, {configured.combination}"
    if math.isnan(configured.error):
        yield f"{name}, has no estimate: {configured.reason}"
        return
    place = ranking.standings.index(configured) + 1
    word = "worse by more than chance" if configured.is_worse else "within chance of the best"
    word += ", but by less than 1 % of the error" if ranking.hardly_worse(configured) else ""
    end = f", {word}" if ranking.has_enough_blocks else ""
    yield f"{name}, is number {place} of {len(ranking.standings)} with {percent(configured.error)}{end}."


def _truth_lines(ranking: Ranking) -> Iterator[str]:
    with_truth = [row for row in ranking.standings if row.truth is not None and math.isfinite(row.truth.over_bound)]
    if not with_truth:
        return
    best = min(with_truth, key=lambda row: row.truth.over_bound if row.truth else math.inf)
    if best.truth is not None:
        yield (
            f"Nearest to the true base parameters is {best.combination}: errors of "
            f"{short(best.truth.over_bound, 2)} times the least standard deviation that any unbiased method can reach "
            f"(rms), {best.truth.covered} of {best.truth.count} intervals of 95 % hold the truth."
        )
        if best.truth.count < len(best.truth.error):
            yield (
                f"Of {len(best.truth.error)} base parameters, {best.truth.count} have a true value and a standard "
                "error; the others lack one, or have parameters in them whose true value is not given."
            )


def _gap_lines(ranking: Ranking) -> Iterator[str]:
    for name in ranking.substituted_smoothers:
        yield (
            f"{name} does not apply to all motion that is held out, where the default spline smooths in its place: its "
            "rows tell how good its parameters are, not its smoothing of that motion."
        )
    # The smoother that drops most samples limits what all are judged on
    if ranking.standings and min(ranking.shares.values()) < MIN_COMMON_PERCENT:
        log = min(ranking.shares, key=lambda name: ranking.shares[name])
        part = min(ranking.kept_shares, key=lambda name: ranking.kept_shares[name])
        yield (
            f"Only {percent(ranking.shares[log])} of the samples of {log} count, those that all smoothers keep; {part} "
            f"keeps fewest, {percent(ranking.kept_shares[part])} of all logs."
        )
    if ranking.failures:
        yield f"{count(len(ranking.failures), 'combination')} of {len(ranking.rows)} gave no estimate:"
        # Combinations that failed for one reason are named together
        reasons = dict.fromkeys((row.reason, row.outcome.value) for row in ranking.failures)
        for reason, outcome in list(reasons)[:MAX_NAMED]:
            names = [str(row.combination) for row in ranking.failures if row.reason == reason]
            yield f"{join_names(names, 2)} ({outcome}): {reason}"
        if len(reasons) > MAX_NAMED:
            yield f"{count(len(reasons) - MAX_NAMED, 'more reason')} in the report, and in what --json writes."
    for reason in dict.fromkeys(row.reason for row in ranking.absent):
        alike = [row for row in ranking.absent if row.reason == reason]
        names = [" with ".join(filter(None, (row.smoother, row.estimator))) for row in alike]
        yield f"Does not apply: {join_names(names)}: {reason}"


def ranking_tables(ranking: Ranking, max_rows: int = MAX_ROWS) -> Iterator[PageTable]:
    """Yield a table of at most so many rows for a terminal, of which the last is that of the configuration."""
    top = ranking.standings[:max_rows]
    configured = ranking.configured_entry
    extra = [configured] if configured is not None and configured not in top and math.isfinite(configured.error) else []
    if top:
        top = top[: max_rows - len(extra)]
        rows = []
        for row in (*top, *extra):
            figures = (number(row.error, 3), *interval_ends(ranking, row), number(row.seconds, 2))
            rows.append((*row.combination.shown_names, *figures, mark_words(ranking, row)))
        interval = (("from", "more than best"), ("to", "more than best"))
        heads = ("mean joint error, %", *interval, "s", Column("", numeric=False))
        omitted, is_held_out = len(ranking.standings) - len(top), ranking.basis == "validation"
        basis = "held-out motion" if is_held_out else "stretches of the training, predicted from the others"
        caption = f"Ranked by {basis}" + (f"; {omitted} more with larger errors" if omitted > 0 else "")
        yield PageTable.of(("smoother", "estimator"), heads, rows, caption)


def interval_ends(ranking: Ranking, row: RankedCombination) -> tuple[str, str]:
    """Return the ends of the interval of the difference to the best; below 1e-4 of the error they are zero."""
    if row is ranking.best:
        return "-", "-"
    low, high = (number(0.0 if abs(x) < MIN_SHOWN_RATIO * row.error else x, 2) for x in row.interval)
    return low, high


def mark_words(ranking: Ranking, row: RankedCombination) -> str:
    """Return a mark of a combination in a word or two: to take, yours, worse."""
    words = ["take" if row is ranking.choice else "", "yours" if row.combination.is_configured else ""]
    words.append(("hardly worse" if ranking.hardly_worse(row) else "worse") if row.is_worse else "")
    return ", ".join(filter(None, words))


def ranking_dict(ranking: Ranking) -> dict[str, Any]:
    """Return a comparison as plain values, for JSON."""
    return {
        "format": "dynident ranking",
        "version": 1,
        "name": ranking.name,
        "sentences": [ranking_heading(ranking), *ranking_findings(ranking)],
        "ranked_by": "held-out logs" if ranking.basis == "validation" else "cross-validation",
        "joints": list(ranking.joints),
        "common_samples": dict(ranking.shares),
        "kept_samples": dict(ranking.kept_shares),
        "time_offsets": dict(ranking.offsets),
        "block_seconds": ranking.block,
        "blocks": ranking.blocks,
        "told_from_chance": ranking.has_enough_blocks,
        "folds": ranking.folds,
        "findings": [_finding_text(group) for group in finding_groups(ranking.findings)],
        "best": _name_pair(ranking.best),
        "take": _name_pair(ranking.choice),
        "contradicted_by": _name_pair(ranking.rival),
        "within_chance": [_name_pair(row) for row in ranking.within_chance],
        "as_good": [_name_pair(row) for row in ranking.as_good],
        "parts": {
            family: [{"name": x.name, "own": x.is_configured, "settings": part_text(x.part)} for x in parts]
            for family, parts in (("smoothers", ranking.smoothers), ("estimators", ranking.estimators))
        },
        "rows": list(map(ranking.numbers, ranking.rows)),
        "does_not_apply": list(map(asdict, ranking.absent)),
        "base_parameters": list(ranking.parameters),
    }


def _name_pair(row: RankedCombination | None) -> list[str] | None:
    return None if row is None else list(row.combination.shown_names)
