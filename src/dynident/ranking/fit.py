"""One smoother with one estimator: what a worker does with it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief, called
from dynident.estimators import Estimate, Estimator, PhysicallyConsistent, Problem
from dynident.estimators.constraints import bodies_of, sized
from dynident.identification import SubstituteUsed, estimated
from dynident.identification.cross_validation import stretch
from dynident.identification.prior_strength import find_prior_strength, with_strength
from dynident.identification.standard_errors import identifiability_of
from dynident.log import Motion
from dynident.ranking.candidates import Candidate
from dynident.ranking.rows import Outcome, empty_row
from dynident.ranking.smoothing import Common, failed, motions_of, shifted, with_common
from dynident.ranking.task import Masks, Task
from dynident.regression import BLOCK, Regression, one_thread
from dynident.smoothers import SUBSTITUTE

__all__ = ["Fit", "Job"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Job:
    """A smoother and an estimator by number, the part of the smoother that is taken, its time offset as in its row, and
    the digest of the row."""

    smoother: int
    estimator: int
    chosen: int
    shift: tuple[float, ...]
    digest: str


@dataclass(frozen=True, eq=False)
class Fit:
    """Estimates by the combination of a job, and judges the estimate on the common samples: a job gives its row."""

    task: Task
    common: Common
    smoothers: tuple[Candidate, ...]
    estimators: tuple[Candidate, ...]

    __repr__ = brief

    def key(self, job: Job) -> tuple[str, str, str]:
        """Return the key of the row of a job."""
        return self.smoothers[job.smoother].name, self.estimators[job.estimator].name, job.digest

    def __call__(self, job: Job) -> dict[str, Any]:
        """Return the row of a combination; whatever is raised is its reason."""
        began = time.perf_counter()
        try:
            with one_thread():
                return self._row(job)
        except Exception as error:  # a combination that fails is a row
            return empty_row(self.key(job), *failed(error), time.perf_counter() - began)

    def _row(self, job: Job) -> dict[str, Any]:
        task, one = self.task, self.smoothers[job.smoother]
        pairing = shifted(one.parts[job.chosen], job.shift, task.late)
        late = pairing.time_offset.seconds if pairing.time_offset else task.late
        motions = with_common(task, motions_of(task, one, pairing.smoother), self.common)
        problem = _problem(task, tuple(motions["train"].values()), late)
        began = time.perf_counter()
        part: Estimator = self.estimators[job.estimator].part
        part = with_strength(part, find_prior_strength(task.model, problem.motions, part))
        estimate, regression, more, noted = estimated(problem, part, pairing, _silent)
        seconds = time.perf_counter() - began
        settled = Outcome.OK if estimate.converged else Outcome.UNSETTLED
        row = empty_row(self.key(job), settled, "", seconds)
        kinds = {type(note) for note in (*estimate.notes, *noted)}
        if any(SUBSTITUTE in motion.smoothing for motion in motions["validation"].values()):
            kinds.add(SubstituteUsed)
        row["notes"] = sorted(kind.__name__ for kind in kinds)
        row["condition"] = _condition(estimate)
        row["eigenvalue"] = _eigenvalue(problem, estimate.value)
        own = with_common(task, task.motions, self.common)
        for column, some, role in (
            ("held", motions, "validation"), ("alike", own, "validation"), ("train", motions, "train"),
        ):  # fmt: skip
            left = _left(task, some[role], estimate.value, self.common.masks, role)
            row[column] = (left if column == "held" else left.sum(axis=0)).ravel().tolist()
        if task.truth is not None:
            errors, base = identifiability_of(
                task.model, regression, estimate, more, _silent, unfitted=task.recipe.unfitted
            )
            row["base"] = task.truth.base(estimate.value).tolist()
            row["std"] = task.truth.std(errors, base).tolist()
        return row | self._crossed(motions["train"], part, late)

    def _crossed(self, motions: Mapping[str, Motion], part: Estimator, late: float) -> dict[str, Any]:
        """Return the columns of the cross-validation; where it fails, the reason."""
        if not self.task.folds:
            return {}
        began = time.perf_counter()
        try:
            cross = _cross_validated(self.task, motions, _plain(part), late)
        except Exception as error:
            outcome, reason = failed(error)
            words = {"reason": f"cross-validation: {reason}"}
            return words if self.task.held_out else words | {"status": outcome.value}
        return {"cross": cross.ravel().tolist(), "cv_seconds": time.perf_counter() - began}


def _silent(_: str) -> None:
    """Show no progress."""


def _problem(task: Task, motions: tuple[Motion, ...], late: float) -> Problem:
    """Return the problem of motions of the training, in the order of its logs."""
    regression = Regression(task.model, motions, task.recipe.filter)
    named = dict(zip(task.logs.repaired["train"], motions, strict=True))
    return Problem(task.model, motions, regression, task.logs.fitted({"train": named}), late)


def _condition(estimate: Estimate) -> float:
    """Return the condition of the scaled regressor, of the directions that the data determine where they are known."""
    known = estimate.determined.directions
    if known is None or not known.rank:
        return float(estimate.determined.condition)
    return float(known.values[0] / known.values[known.rank - 1])


def _eigenvalue(problem: Problem, value: Array) -> float | None:
    """Return the smallest eigenvalue of the pseudo-inertias, relative to the usual size of a body; None without any."""
    parameters = problem.model.parameters
    bodies = sized(bodies_of(parameters), parameters, problem.regression.triangular_factors)
    return min((float(np.linalg.eigvalsh(body.scaled(value))[0]) for body in bodies), default=None)


def _left(task: Task, motions: Mapping[str, Motion], value: Array, masks: Masks, role: str) -> Array:
    """Return the sums of squares (K, n) of what parameters leave of the unfiltered torque, in the blocks of a role."""
    return task.squares(_residuals(task, motions, value), masks, role, fitted=False)


def _residuals(task: Task, motions: Mapping[str, Motion], value: Array) -> dict[str, Array]:
    found = {}
    for name, motion in motions.items():
        parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
        predicted = np.concatenate([task.model.torque(**motion.states(one), theta=value) for one in parts])
        found[name] = motion.tau - predicted
    return found


def _plain(part: Estimator) -> Estimator:
    return replace(part, costs=False) if isinstance(part, PhysicallyConsistent) else part


def _cross_validated(task: Task, motions: Mapping[str, Motion], part: Estimator, late: float) -> Array:
    """Return the sums of squares (K, n) of what is left of stretches of time, each predicted from all others."""
    total: Array | float = 0.0
    for k in range(task.folds):
        left = {name: stretch(one, k, task.folds) for name, one in motions.items()}
        rest = tuple(replace(one, mask=one.mask & ~left[name].mask) for name, one in motions.items())
        value = called(part, _problem(task, rest, late), Estimate).value
        masks = {"train": {name: one.mask for name, one in left.items()}}
        total = total + task.squares(_residuals(task, left, value), masks, "train", fitted=True)
    return np.asarray(total)
