"""Assemble a ranking from rows: errors on common samples, differences beyond chance, what does not apply."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
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
from dynident.apps.ranking.task import (
    CommonSamples,
    Task,
    describe_failure,
    empty_row,
    pack_masks,
    restore_alignment,
    smoothed_motions,
    with_common_samples,
)
from dynident.estimators import Estimate, Estimator, PhysicallyConsistent, Problem, bodies_of, estimate_sizes
from dynident.identification import PriorStrength, SubstituteUsed, estimate_parameters, find_prior_strength
from dynident.identification.cross_validation import keep_fold
from dynident.identification.dataset import RoleMotions
from dynident.identification.prior_strength import with_strength
from dynident.identification.uncertainty import identifiability_of
from dynident.motion.log import Motion
from dynident.motion.smoothers import SUBSTITUTE
from dynident.regression import BLOCK, MAX_REPEAT_DIFFERENCE, Regression, Selection, one_thread, repeat_of
from dynident.runtime import Noun, call_part
from dynident.runtime.arrays import Array
from dynident.runtime.cache import Cache

Row = Mapping[str, Any]
_STRENGTH_CACHE: Cache[tuple[PriorStrength | None, float]] = Cache(64)  # found last by this process, with seconds


@dataclass(frozen=True)
class Job:
    """A combination by the numbers of smoother and estimator.

    ``part_number`` is the part of the smoother that is taken, ``shift`` its time offset as in its row, ``digest``
    that of the row. ``cross_validate`` is whether it is fitted to the folds, too.
    """

    smoother: int
    estimator: int
    part_number: int
    shift: tuple[float, ...]
    digest: str
    cross_validate: bool = True


class Fit(Noun):
    """Estimate by the combination of a job, and validate the estimate on the common samples.

    Called with a job it returns its row.
    """

    task: Task
    common: CommonSamples
    smoothers: tuple[Candidate, ...]
    estimators: tuple[Candidate, ...]

    def key(self, job: Job) -> tuple[str, str, str]:
        """Return the key of the row of a job."""
        return self.smoothers[job.smoother].name, self.estimators[job.estimator].name, job.digest

    def __call__(self, job: Job) -> dict[str, Any]:
        """Return the row of a combination; an exception becomes its reason."""
        began = time.perf_counter()
        try:
            with one_thread():
                return self._row(job)
        except Exception as error:  # a combination that fails is a row
            return empty_row(self.key(job), *describe_failure(error), time.perf_counter() - began)

    def _row(self, job: Job) -> dict[str, Any]:
        task, candidate = self.task, self.smoothers[job.smoother]
        alignment = restore_alignment(candidate.parts[job.part_number], job.shift, task.time_offset)
        late = alignment.time_offset.seconds if alignment.time_offset else task.time_offset
        motions = with_common_samples(task, smoothed_motions(task, candidate, alignment.smoother), self.common)
        problem = _train_problem(task, tuple(motions["train"].values()), late)
        # only the estimate is timed, with the choice of the strength of its prior
        part: Estimator = self.estimators[job.estimator].part
        prior, prior_seconds = self._prior_strength(part, problem, candidate)
        began, part = time.perf_counter(), with_strength(part, prior)
        fit = estimate_parameters(problem, part, alignment)
        estimate = fit.estimate
        seconds = prior_seconds + time.perf_counter() - began
        settled = CombinationOutcome.OK if estimate.converged else CombinationOutcome.UNSETTLED
        row = empty_row(self.key(job), settled, "", seconds)
        # notes are kept by the names of their types, for the report
        kinds = {type(note) for note in (*estimate.notes, *fit.notes)}
        if any(SUBSTITUTE in motion.smoothing for motion in motions["validation"].values()):
            kinds.add(SubstituteUsed)
        row["notes"] = sorted(kind.__name__ for kind in kinds)
        row["condition"] = _regressor_condition(estimate)
        row["eigenvalue"] = _smallest_eigenvalue(problem, estimate.value)
        # errors on the motions of the configured smoother differ between combinations by the parameters alone
        configured_motions = with_common_samples(task, task.motions, self.common)
        for column, motion_set, role in (
            ("held", motions, "validation"), ("alike", configured_motions, "validation"), ("train", motions, "train"),
        ):  # fmt: skip
            residuals = _torque_residuals(task, motion_set[role], estimate.value)
            squares = task.squares(residuals, self.common.masks, role, fitted_only=False)
            row[column] = (squares if column == "held" else squares.sum(axis=0)).ravel().tolist()
        if task.truth is not None:
            unfitted = task.recipe.unfitted
            errors, base = identifiability_of(fit.regression, estimate, fit.motion_covariance, unfitted=unfitted)
            row["base"] = task.truth.base(estimate.value).tolist()
            row["std"] = task.truth.std(errors, base).tolist()
        return row | (self._cross_validation_columns(motions["train"], part, late) if job.cross_validate else {})

    def _prior_strength(
        self, part: Estimator, problem: Problem, candidate: Candidate
    ) -> tuple[PriorStrength | None, float]:
        """Return the strength of the prior, and the seconds it took; it is found once for each quick fit."""
        if not isinstance(part, PhysicallyConsistent):
            return None, 0.0

        def find() -> tuple[PriorStrength | None, float]:
            began = time.perf_counter()
            return find_prior_strength(self.task.model, problem.motions, part), time.perf_counter() - began

        # the strength is that of the quick fit, which most estimators share
        quick_part = replace(part, fit=part.linear.quick())
        samples = self.task.digest, pack_masks(self.common.masks), candidate.settings
        return _STRENGTH_CACHE((*samples, repr(quick_part)), find)

    def _cross_validation_columns(
        self, motions: Mapping[str, Motion], part: Estimator, time_offset: float
    ) -> dict[str, Any]:
        """Return the columns of the cross-validation, or its reason where it fails."""
        if not self.task.folds:
            return {}
        began = time.perf_counter()
        try:
            part = replace(part, costs=False) if isinstance(part, PhysicallyConsistent) else part
            cross = _cross_validation_squares(self.task, motions, part, time_offset)
        except Exception as error:
            outcome, reason = describe_failure(error)
            words = {"reason": f"cross-validation: {reason}"}
            return words if self.task.held_out else words | {"status": outcome.value}
        return {"cross": cross.ravel().tolist(), "cv_seconds": time.perf_counter() - began}


def _train_problem(task: Task, motions: tuple[Motion, ...], time_offset: float) -> Problem:
    """Return the estimation problem of the motions of the training, in the order of its logs."""
    regression = Regression(task.model, motions, Selection(task.recipe.filter))
    train_motions = dict(zip(task.logs.repaired["train"], motions, strict=True))
    logs = task.logs.fitted_logs(RoleMotions({"train": train_motions}))
    return Problem(task.model, motions, regression, logs, time_offset)


def _regressor_condition(estimate: Estimate) -> float:
    """Return the condition number of the scaled regressor.

    It is that within the directions that the data determine, where these are known.
    """
    directions = estimate.determined.directions
    if directions is None or not directions.rank:
        return float(estimate.determined.condition)
    return float(directions.values[0] / directions.values[directions.rank - 1])


def _smallest_eigenvalue(problem: Problem, value: Array) -> float | None:
    """Return the smallest eigenvalue of the pseudo-inertias, relative to the usual size of a body.

    None without bodies.
    """
    parameters = problem.model.parameters
    bodies = estimate_sizes(bodies_of(parameters), parameters, problem.regression.triangular_factors)
    return min((float(np.linalg.eigvalsh(body.scaled_inertia(value))[0]) for body in bodies), default=None)


def _torque_residuals(task: Task, motions: Mapping[str, Motion], value: Array) -> dict[str, Array]:
    residuals = {}
    for name, motion in motions.items():
        # in blocks of rows, as the kinematics of a long log at once would take too much memory
        parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
        predicted = np.concatenate([task.model.torque(**motion.states(rows), theta=value) for rows in parts])
        residuals[name] = motion.tau - predicted
    return residuals


def _cross_validation_squares(task: Task, motions: Mapping[str, Motion], part: Estimator, time_offset: float) -> Array:
    """Return the sums of squares (K, n) of the residuals of stretches of time, each predicted from all others."""
    total: Array | float = 0.0
    for k in range(task.folds):
        held_out = {name: keep_fold(motion, k, task.folds) for name, motion in motions.items()}
        # remove the held-out stretch from the mask, and fit the rest
        remaining = tuple(replace(motion, mask=motion.mask & ~held_out[name].mask) for name, motion in motions.items())
        value = call_part(part, _train_problem(task, remaining, time_offset), Estimate).value
        masks = {"train": {name: motion.mask for name, motion in held_out.items()}}
        total = total + task.squares(_torque_residuals(task, held_out, value), masks, "train", fitted_only=True)
    return np.asarray(total)


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
