"""Assemble a ranking from rows: errors on common samples, differences beyond chance, what does not apply."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from dynident.apps.ranking.config import Candidate, Combination
from dynident.apps.ranking.differences import Differences, differences, joint_errors, mean_error
from dynident.apps.ranking.ranking import (
    Basis,
    CombinationOutcome,
    InapplicablePart,
    RankedCombination,
    Ranking,
    TruthFigures,
)
from dynident.apps.ranking.task import CommonSamples, Task
from dynident.regression import MAX_REPEAT_DIFFERENCE, repeat_of
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

Row = Mapping[str, Any]


class ComparisonRows(Noun):
    """All rows of a comparison: one of each smoother in ``smooth``.

    In ``fits`` those of the combinations, by both numbers.
    """

    smoothers: tuple[Candidate, ...]
    estimators: tuple[Candidate, ...]
    smooth: list[Row]
    fits: Mapping[tuple[int, int], Row]
    common: CommonSamples
    computed: int


def assemble_ranking(name: str, task: Task, rows: ComparisonRows, rng: np.random.Generator) -> Ranking:
    """Return the ranking of all rows; ``rng`` draws the blocks of time."""
    basis: Basis = "validation" if task.held_out else "train"
    column = "held" if task.held_out else "cross"
    torque = task.torque_squares(rows.common.masks, basis, fitted_only=not task.held_out)
    block_squares = _block_squares(rows.fits, column, torque)
    combinations = {key: _read_row(task, rows, key, row) for key, row in rows.fits.items()}
    difference_test: Differences | None = None
    if block_squares:
        difference_test = differences(np.stack(list(block_squares.values())), torque, task.blocks[basis].log, rng)
        for k, key in enumerate(block_squares):
            combinations[key] = replace(
                combinations[key], error=float(difference_test.error[k]),
                overall=_overall_error(block_squares[key], torque), p_value=float(difference_test.p_value[k]),
                interval=(float(difference_test.interval[k, 0]), float(difference_test.interval[k, 1])),
            )  # fmt: skip
    _add_cross_p_values(task, rows, combinations, rng)
    attempted, not_smoothed = list(combinations.values()), list(_rows_without_motion(rows))
    entries = [*attempted, *not_smoothed]
    applicable = [entry for entry in entries if entry.outcome is not CombinationOutcome.NOT_APPLICABLE]
    # those without an error come last
    ordered = sorted(applicable, key=lambda entry: entry.error if math.isfinite(entry.error) else math.inf)
    block, blocks, has_enough_blocks = math.nan, 0.0, False
    if difference_test is not None:
        block = difference_test.length * task.blocks[basis].seconds
        blocks, has_enough_blocks = difference_test.drawn_blocks, difference_test.has_enough_blocks
    names, units = ((), ()) if task.truth is None else (task.truth.names, task.truth.units)
    # of several parts of a smoother the one that was chosen
    smoothers = tuple(
        smoother if row["chosen"] is None else replace(smoother, parts=(smoother.parts[row["chosen"]],))
        for smoother, row in zip(rows.smoothers, rows.smooth, strict=True)
    )
    return Ranking(
        name, task.joints, basis, rows=tuple(ordered), absent=tuple(_inapplicable_parts(attempted, not_smoothed)),
        shares=rows.common.shares, kept_shares=rows.common.kept_shares, block=block, blocks=blocks,
        has_enough_blocks=has_enough_blocks, folds=task.folds, parameters=names, units=units, smoothers=smoothers,
        estimators=rows.estimators, computed=rows.computed, repeats=tuple(_repeated_logs(task)),
        findings=task.findings, offsets=_time_offsets(task, rows),
    )  # fmt: skip


def _block_squares(fits: Mapping[tuple[int, int], Row], column: str, torque: Array) -> dict[tuple[int, int], Array]:
    """Return the sums of squares (K, n) in a column by combination, where they are finite: others cannot be tested."""
    arrays = {key: np.reshape(row[column], torque.shape) for key, row in fits.items() if len(row[column])}
    return {key: squares for key, squares in arrays.items() if np.isfinite(squares).all()}


def _repeated_logs(task: Task) -> Iterator[tuple[str, str]]:
    """Yield the held-out logs that repeat a motion of the training, each with the first log that it repeats."""
    train = task.motions["train"]
    for held_out_name, motion in task.motions["validation"].items():
        repeats = (log for log in train if repeat_of(motion, train[log]).error < MAX_REPEAT_DIFFERENCE)
        yield from ((held_out_name, log) for log in islice(repeats, 1))


def _add_cross_p_values(
    task: Task, rows: ComparisonRows, combinations: dict[tuple[int, int], RankedCombination], rng: np.random.Generator
) -> None:
    """Add the p-values of cross-validation to the combinations that are ranked by held-out logs."""
    # cross-validation is on the training logs, with other blocks than the held-out logs
    torque = task.torque_squares(rows.common.masks, "train", fitted_only=True)
    ranked = [key for key, entry in combinations.items() if task.held_out and math.isfinite(entry.error)]
    block_squares = _block_squares({key: rows.fits[key] for key in ranked}, "cross", torque)
    if block_squares:
        difference_test = differences(np.stack(list(block_squares.values())), torque, task.blocks["train"].log, rng)
        for key, p_value in zip(block_squares, difference_test.p_value, strict=True):
            combinations[key] = replace(combinations[key], cross_p_value=float(p_value))


def _time_offsets(task: Task, rows: ComparisonRows) -> dict[str, float]:
    """Return the time offset (s) of each smoother that works."""
    pairs = zip(rows.smoothers, rows.smooth, strict=True)
    return {
        smoother.name: row["shift"][0] if len(row["shift"]) else task.time_offset
        for smoother, row in pairs
        if row["status"] == CombinationOutcome.OK
    }


def _read_row(task: Task, rows: ComparisonRows, key: tuple[int, int], row: Row) -> RankedCombination:
    """Return the figures of a combination from its row, without its place among the others."""
    i, j = key
    combination = _combination(rows, i, j)
    outcome = CombinationOutcome(row["status"])
    if not len(row["train"]):
        return RankedCombination(combination, outcome, row["reason"])
    masks = rows.common.masks
    total_torque = task.torque_squares(masks, "train", fitted_only=False).sum(axis=0)
    fitted_torque = task.torque_squares(masks, "train", fitted_only=True)
    held_out_torque = task.torque_squares(masks, "validation", fitted_only=False)
    return RankedCombination(
        combination,
        outcome,
        row["reason"],
        held_out=_block_errors(task, row["held"], held_out_torque) if task.held_out else {},
        same_motion=_errors_by_joint(task, row["alike"], held_out_torque.sum(axis=0)) if task.held_out else {},
        training=_errors_by_joint(task, row["train"], total_torque),
        cross_validated=_block_errors(task, row["cross"], fitted_torque),
        condition=math.nan if row["condition"] is None else row["condition"],
        eigenvalue=row["eigenvalue"],
        seconds_smoothing=rows.smooth[i]["seconds"],
        seconds_estimate=row["seconds"],
        seconds_validation=math.nan if row["cv_seconds"] is None else row["cv_seconds"],
        notes=tuple(row["notes"]),
        truth=None if task.truth is None else TruthFigures.of(task.truth, row["base"], row["std"]),
    )


def _block_errors(task: Task, values: list[float], torque: Array) -> dict[str, float]:
    if not len(values):
        return {}
    return _errors_by_joint(task, np.reshape(values, torque.shape).sum(axis=0), torque.sum(axis=0))


def _errors_by_joint(task: Task, squares: list[float] | Array, torque: Array) -> dict[str, float]:
    """Return the errors by joint from sums of squares (n)."""
    return dict(zip(task.joints, joint_errors(np.asarray(squares), torque).tolist(), strict=True))


def held_out_error(task: Task, common: CommonSamples, row: Row) -> float:
    """Return the error (%) by which held-out logs rank a row, infinite where it has none."""
    if not len(row["held"]):
        return math.inf
    torque = task.torque_squares(common.masks, "validation", fitted_only=False)
    error = float(mean_error(np.reshape(row["held"], torque.shape).sum(axis=0), torque.sum(axis=0)))
    return error if math.isfinite(error) else math.inf


def _overall_error(squares: Array, torque: Array) -> float:
    """Return the relative error (%) of the torques of all joints together, without joints that have none."""
    has_torque = torque.sum(axis=0) > 0
    return float(100.0 * np.sqrt(squares[:, has_torque].sum() / torque.sum()))


def _combination(rows: ComparisonRows, i: int, j: int) -> Combination:
    smoother, estimator = rows.smoothers[i], rows.estimators[j]
    return Combination(smoother.name, estimator.name, smoother.is_configured and estimator.is_configured)


def _rows_without_motion(rows: ComparisonRows) -> Iterator[RankedCombination]:
    """Yield the combinations whose smoother takes no part, with its reason."""
    for i, row in enumerate(rows.smooth):
        name = rows.smoothers[i].name
        outcome = CombinationOutcome.TOO_FEW if name in rows.common.excluded else CombinationOutcome(row["status"])
        if outcome is CombinationOutcome.OK:
            continue
        reason = rows.common.excluded.get(name) or row["reason"]
        for j in range(len(rows.estimators)):
            yield RankedCombination(_combination(rows, i, j), outcome, reason)


def _inapplicable_parts(
    attempted: list[RankedCombination], not_smoothed: list[RankedCombination]
) -> Iterator[InapplicablePart]:
    """Yield what does not apply: a smoother, an estimator with all that were ``attempted``, or one combination."""
    lacking = [entry for entry in not_smoothed if entry.outcome is CombinationOutcome.NOT_APPLICABLE]
    for name, reason in dict.fromkeys((entry.combination.smoother, entry.reason) for entry in lacking):
        yield InapplicablePart(name, "", reason)
    inapplicable = [entry for entry in attempted if entry.outcome is CombinationOutcome.NOT_APPLICABLE]
    for name in dict.fromkeys(entry.combination.estimator for entry in inapplicable):
        # where all combinations of an estimator fail for one reason, report the estimator alone
        rejected = [entry for entry in inapplicable if entry.combination.estimator == name]
        alike = len({entry.reason for entry in rejected}) == 1
        if alike and len(rejected) == sum(entry.combination.estimator == name for entry in attempted):
            yield InapplicablePart("", name, rejected[0].reason)
        else:
            yield from (InapplicablePart(entry.combination.smoother, name, entry.reason) for entry in rejected)
