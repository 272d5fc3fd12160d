"""Fit combinations of a smoother and estimators on the common samples, and give each a row."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynident.apps.ranking.config import Candidate
from dynident.apps.ranking.ranking import CombinationOutcome
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
from dynident.estimators import Estimate, Estimator, LinearEstimator, PhysicallyConsistent, Problem, estimate_sizes
from dynident.identification import Alignment, PriorStrength, SubstituteUsed, estimate_parameters, find_prior_strength
from dynident.identification.cross_validation import keep_fold
from dynident.identification.dataset import RoleMotions
from dynident.identification.prior_strength import with_strength
from dynident.identification.uncertainty import identifiability_of
from dynident.motion.log import Motion
from dynident.motion.smoothers import SUBSTITUTE
from dynident.regression import Regression, Selection, one_thread
from dynident.runtime import DynidentError, Noun, call_part
from dynident.runtime.arrays import Array
from dynident.runtime.cache import Cache
from dynident.validation import predict_torque

# what this process has computed last
_STRENGTH_CACHE: Cache[tuple[PriorStrength | None, float]] = Cache(64)  # with its seconds
_SAMPLES_CACHE: Cache[SmoothedSamples] = Cache(2)


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


class SmoothedSamples(Noun):
    """The common samples as one smoother has them: ``motions`` by role and log, and the ``problem`` of the training.

    In ``folds`` are those of the cross-validation: the motions that are held out, and the problem of all others.
    ``seconds`` and ``fold_seconds`` are what the factors of the problems took, which all estimators share.
    """

    motions: Mapping[str, Mapping[str, Motion]]
    problem: Problem
    folds: tuple[tuple[Mapping[str, Motion], Problem], ...]
    seconds: float
    fold_seconds: float

    def fresh(self) -> SmoothedSamples:
        """Return the samples with problems that know the factors, but no fit."""
        folds = tuple((motions, replace(problem)) for motions, problem in self.folds)
        return replace(self, problem=replace(self.problem), folds=folds)


class Fit(Noun):
    """Estimate by combinations of one smoother, and validate each estimate on the common samples.

    Called with jobs it returns their rows. Estimators that begin with the same rows should come together: these are
    computed once.
    """

    task: Task
    common: CommonSamples
    smoothers: tuple[Candidate, ...]
    estimators: tuple[Candidate, ...]

    def key(self, job: Job) -> tuple[str, str, str]:
        """Return the key of the row of a job."""
        return self.smoothers[job.smoother].name, self.estimators[job.estimator].name, job.digest

    def __call__(self, jobs: Sequence[Job]) -> list[dict[str, Any]]:
        """Return the row of each combination; an exception becomes its reason."""
        rows, samples = list[dict[str, Any]](), None
        for job in jobs:
            began = time.perf_counter()
            try:
                with one_thread():
                    samples = samples or self._samples(job).fresh()
                    rows.append(self._row(job, samples))
            except Exception as error:  # a combination that fails is a row
                rows.append(empty_row(self.key(job), *describe_failure(error), time.perf_counter() - began))
        return rows

    def _alignment(self, job: Job) -> tuple[Alignment, float]:
        """Return the smoother of a job with its time offset, and that offset (s)."""
        part = self.smoothers[job.smoother].parts[job.part_number]
        alignment = restore_alignment(part, job.shift, self.task.time_offset)
        return alignment, alignment.time_offset.seconds if alignment.time_offset else self.task.time_offset

    def _samples(self, job: Job) -> SmoothedSamples:
        """Return the samples of the smoother of a job, which a process keeps for its next jobs."""
        task, candidate, (alignment, seconds) = self.task, self.smoothers[job.smoother], self._alignment(job)

        def smooth() -> SmoothedSamples:
            motions = smoothed_motions(task, candidate, alignment.smoother)
            return _smoothed_samples(task, with_common_samples(task, motions, self.common), seconds)

        if task.is_long:  # a cache of long logs would fill the memory
            return smooth()
        key = task.digest, candidate.settings, repr(alignment.smoother), pack_masks(self.common.masks)
        return _SAMPLES_CACHE(key, smooth)

    def _row(self, job: Job, samples: SmoothedSamples) -> dict[str, Any]:
        task, motions, problem, (alignment, _) = self.task, samples.motions, samples.problem, self._alignment(job)
        # only the estimate is timed, with the factors of its rows and the choice of the strength of its prior
        part: Estimator = self.estimators[job.estimator].part
        prior, prior_seconds = self._prior_strength(part, problem, self.smoothers[job.smoother])
        part = with_strength(part, prior)
        shared_seconds = samples.seconds + prior_seconds + _seconds_of_rows(problem, part)
        began = time.perf_counter()
        # the covariance by noise of the motion counts where errors are compared with the true parameters
        fit = estimate_parameters(problem, part, alignment, needs_noise=task.truth is not None)
        estimate = fit.estimate
        seconds = shared_seconds + time.perf_counter() - began
        settled = CombinationOutcome.OK if estimate.converged else CombinationOutcome.UNSETTLED
        row = empty_row(self.key(job), settled, "", seconds)
        # notes are kept by the names of their types, for the report
        kinds = {type(note) for note in (*estimate.notes, *fit.notes)}
        if any(SUBSTITUTE in motion.smoothing for motion in motions["validation"].values()):
            kinds.add(SubstituteUsed)
        row["notes"] = sorted(kind.__name__ for kind in kinds)
        row["condition"] = float(estimate.determined.determined_condition)
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
        return row | (self._cross_validation_columns(samples, part) if job.cross_validate else {})

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

    def _cross_validation_columns(self, samples: SmoothedSamples, part: Estimator) -> dict[str, Any]:
        """Return the columns of the cross-validation, or its reason where it fails."""
        if not samples.folds:
            return {}
        try:
            part = replace(part, costs=False) if isinstance(part, PhysicallyConsistent) else part
            shared_seconds = sum(
                (_seconds_of_rows(problem, part) for _, problem in samples.folds), samples.fold_seconds
            )
            began = time.perf_counter()
            cross = _cross_validation_squares(self.task, samples.folds, part)
        except Exception as error:
            outcome, reason = describe_failure(error)
            words = {"reason": f"cross-validation: {reason}"}
            return words if self.task.held_out else words | {"status": outcome.value}
        return {"cross": cross.ravel().tolist(), "cv_seconds": shared_seconds + time.perf_counter() - began}


def _smoothed_samples(task: Task, motions: Mapping[str, Mapping[str, Motion]], time_offset: float) -> SmoothedSamples:
    """Return the samples with the problems of the training and of its folds."""
    train, folds = motions["train"], []
    for k in range(task.folds):
        held_out = {name: keep_fold(motion, k, task.folds) for name, motion in train.items()}
        # remove the held-out stretch from the mask, and fit the rest
        remaining = tuple(replace(motion, mask=motion.mask & ~held_out[name].mask) for name, motion in train.items())
        folds.append((held_out, _train_problem(task, remaining, time_offset)))
    problem, fold_seconds = _train_problem(task, tuple(train.values()), time_offset), 0.0
    seconds = _factor_seconds(problem)
    for _, fold_problem in folds:
        with suppress(DynidentError):  # too few samples of a fold are the reason of each row
            fold_seconds += _factor_seconds(fold_problem)
    return SmoothedSamples(motions, problem, tuple(folds), seconds, fold_seconds)


def _factor_seconds(problem: Problem) -> float:
    """Return the seconds that the factors of a problem take, which it keeps."""
    return _seconds_of(lambda: problem.regression.triangular_factors)


def _seconds_of(compute: Callable[[], object]) -> float:
    """Return the seconds of a call."""
    began = time.perf_counter()
    compute()
    return time.perf_counter() - began


def _seconds_of_rows(problem: Problem, part: Estimator) -> float:
    """Return the seconds that the rows behind an estimate took, also where another estimator had them computed."""
    linear = part.linear if isinstance(part, PhysicallyConsistent) else part
    if not isinstance(linear, LinearEstimator):
        return 0.0
    return problem.fact(("seconds", linear), lambda: _seconds_of(lambda: linear.rows(problem)))


def _train_problem(task: Task, motions: tuple[Motion, ...], time_offset: float) -> Problem:
    """Return the estimation problem of the motions of the training, in the order of its logs."""
    regression = Regression(task.model, motions, Selection(task.recipe.filter))
    train_motions = dict(zip(task.logs.repaired["train"], motions, strict=True))
    logs = task.logs.fitted_logs(RoleMotions({"train": train_motions}))
    return Problem(task.model, motions, regression, logs, time_offset)


def _smallest_eigenvalue(problem: Problem, value: Array) -> float | None:
    """Return the smallest eigenvalue of the pseudo-inertias, relative to the usual size of a body.

    None without bodies.
    """
    bodies = estimate_sizes(problem.model.parameters, problem.regression.triangular_factors)
    return min((float(np.linalg.eigvalsh(body.scaled_inertia(value))[0]) for body in bodies), default=None)


def _torque_residuals(task: Task, motions: Mapping[str, Motion], value: Array) -> dict[str, Array]:
    return {name: motion.tau - predict_torque(task.model, motion, value) for name, motion in motions.items()}


def _cross_validation_squares(
    task: Task, folds: Sequence[tuple[Mapping[str, Motion], Problem]], part: Estimator
) -> Array:
    """Return the sums of squares (K, n) of the residuals of stretches of time, each predicted from all others."""
    total: Array | float = 0.0
    for held_out, problem in folds:
        value = call_part(part, problem, Estimate).value
        masks = {"train": {name: motion.mask for name, motion in held_out.items()}}
        total = total + task.squares(_torque_residuals(task, held_out, value), masks, "train", fitted_only=True)
    return np.asarray(total)
