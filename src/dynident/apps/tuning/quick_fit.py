"""The quick fit of a tuning, without the slow corrections: parameters, errors, torque measured and predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import blake2b
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Estimate, Estimator, PhysicallyConsistent, Problem
from dynident.identification.cross_validation import prediction_errors
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.regression import (
    BLOCK,
    BaseParameters,
    Regression,
    TriangularFactors,
    base_parameters,
    base_std,
    factorise,
    merge_factors,
)
from dynident.runtime import InputError, brief, call_part
from dynident.validation import relative_errors

Array = NDArray[np.float64]
FOLDS = 5  # as many as a smoother is chosen by
Mask = NDArray[np.bool_]
Motions = Mapping[str, Mapping[str, Motion]]


def fold_factors(regression: Regression, folds: int = FOLDS) -> tuple[TriangularFactors, ...]:
    """Return the factors of each of ``folds`` stretches, with equal shares of the samples of each motion.

    Rows are filtered as in the whole, so that merging all gives its factors.
    """
    by_fold = []
    for k in range(folds):
        parts = []
        for i, motion in enumerate(regression.motions):
            start, stop = _edges(motion, folds)[k]
            parts.append(factorise(regression.entries(within=(i, slice(start, stop))), regression.model.structure))
        by_fold.append(merge_factors(parts))
    return tuple(by_fold)


def _edges(motion: Motion, folds: int) -> list[tuple[int, int]]:
    """Return where the folds of a motion start and stop."""
    usable = np.flatnonzero(motion.mask)
    inner = [int(rows[0]) if len(rows) else len(motion) for rows in np.array_split(usable, folds)[1:]]
    return list(pairwise([0, *inner, len(motion)]))


def columns_in(full_model: Model, model: Model) -> NDArray[np.intp] | None:
    """Return the columns of the parameters of a model in one with more terms; None where one is missing."""
    places = {name: k for k, name in enumerate(full_model.names)}
    if not set(model.names) <= places.keys():
        return None
    return np.array([places[name] for name in model.names], dtype=np.intp)


def select_columns(parts: Sequence[TriangularFactors], columns: NDArray[np.intp]) -> tuple[TriangularFactors, ...]:
    """Return the factors of a selection of columns, with the torque."""
    indices = np.append(columns, parts[0].factors.shape[2] - 1)
    return tuple(
        TriangularFactors(np.asarray(np.linalg.qr(part.factors[:, :, indices], mode="r")), part.rows) for part in parts
    )


def keep_unfitted(motion: Motion, unfitted: Sequence[str]) -> Motion:
    """Return a motion in which joints that are not fitted keep the samples that all others keep.

    Its factors serve any choice of joints, once ``without_joints`` has left some out.
    """
    if motion.keep is None or not unfitted:
        return motion
    is_fitted = np.array([name not in unfitted for name in motion.joints])
    others_kept: NDArray[np.bool_] = np.asarray(motion.keep[:, is_fitted].all(axis=1))
    keep: NDArray[np.bool_] = np.asarray(motion.keep | (others_kept[:, None] & ~is_fitted))
    return replace(motion, keep=None if keep.all() else keep)


def without_joints(parts: Sequence[TriangularFactors], joints: Sequence[int]) -> tuple[TriangularFactors, ...]:
    """Return the factors without the equations of some joints."""
    is_kept = np.ones(len(parts[0].rows), dtype=int)
    is_kept[list(joints)] = 0
    return tuple(TriangularFactors(part.factors * is_kept[:, None, None], part.rows * is_kept) for part in parts)


def digest(motions: Sequence[Motion], logs: Sequence[Log]) -> bytes:
    """Return a digest of which torque equations are fitted, and of the torques that differ from those of the logs."""
    hasher = blake2b(digest_size=16)
    for motion, log in zip(motions, logs, strict=True):
        hasher.update(b"all" if motion.keep is None else motion.keep.tobytes())
        hasher.update(b"" if motion.tau is log.tau else motion.tau.tobytes())
    return hasher.digest()


@dataclass(frozen=True, eq=False)
class LogPrediction:
    """The torque of one log: its ``motion``, with the measured torque ``tau`` (N, n), and the ``predicted`` (N, n).

    ``error`` and ``by_joint`` are relative errors (%) over the usable samples, unfiltered, as a report states them; nan
    of a joint that was never recorded.
    """

    name: str
    role: Literal["train", "validation"]
    motion: Motion
    predicted: Array
    error: float
    by_joint: Mapping[str, float]

    __repr__ = brief

    @property
    def fitted_mask(self) -> Mask:
        """Which torques (N, n) are fitted: none of a held-out log."""
        keep = np.ones(self.motion.q.shape, dtype=bool) if self.motion.keep is None else self.motion.keep
        return np.asarray(self.motion.mask[:, None] & keep & (self.role == "train"))


@dataclass(frozen=True, eq=False)
class QuickFit:
    """The fit of a tuning with its ``model``: the ``estimate``, and ``logs`` by name, those of the training first.

    It lacks the correction of ``Bench.identify`` for the bias by errors of the motion, and its standard errors
    are those for independent residuals: true ones are larger. ``cross_validated`` (%) is the error of stretches
    of the training predicted from the others by least squares, over the torques that are fitted, and
    ``cross_validated_by_joint`` that of each joint, nan where nothing is fitted. ``exact`` is False where the
    estimator has been replaced by a faster one. ``seconds`` is the computing time.
    """

    model: Model
    estimate: Estimate
    factors: TriangularFactors
    logs: Mapping[str, LogPrediction]
    cross_validated: float
    cross_validated_by_joint: Mapping[str, float]
    exact: bool
    seconds: float = 0.0

    __repr__ = brief

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters (p)."""
        return self.estimate.names

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return self.estimate.units

    @property
    def value(self) -> Array:
        """Their values (p)."""
        return self.estimate.value

    @property
    def std(self) -> Array:
        """Their standard errors (p) for independent residuals, infinite where the data do not determine one."""
        return self.estimate.std

    @property
    def is_determined(self) -> Mask:
        """Which of them (p) the data determine."""
        return np.isfinite(self.std)

    @property
    def rank(self) -> int:
        """The number of directions of the parameters that the data determine."""
        return self.estimate.determined.rank

    @cached_property
    def condition(self) -> float:
        """Ratio of the largest to the smallest singular value of the column-scaled regressor that counts: among the
        directions that the data determine."""
        directions = self.estimate.determined.directions
        if directions is None or not directions.rank:
            return self.estimate.determined.condition
        return float(directions.values[0] / directions.values[directions.rank - 1])

    @cached_property
    def base(self) -> BaseParameters:
        """The base parameters on the data: combinations that are determined; each parameter itself where all are."""
        directions = self.estimate.determined.directions
        return base_parameters(
            self.factors.stack(self.estimate.residual.weights) if directions is None else directions,
            self.model.parameters,
        )

    @cached_property
    def base_value(self) -> Array:
        """Values (r) of the base parameters."""
        return self.base.to_base(self.value)

    @cached_property
    def base_std(self) -> Array:
        """Standard errors (r) of the base parameters for independent residuals."""
        residual = self.estimate.residual
        return base_std(self.base, self.factors, residual.sigma, residual.weights)

    def held_out(self) -> Mapping[str, LogPrediction]:
        """Return the held-out logs by name."""
        return {name: log for name, log in self.logs.items() if log.role == "validation"}


def quick_estimate(problem: Problem, estimator: Estimator) -> tuple[Estimate, bool]:
    """Return the estimate without its slow parts, and whether it is that of the estimator itself."""
    if isinstance(estimator, PhysicallyConsistent):
        fit = None if estimator.fit is None else estimator.fit.quick()
        return call_part(replace(estimator, costs=False, fit=fit), problem, Estimate), fit is estimator.fit
    fast = estimator.quick()
    return call_part(fast, problem, Estimate), fast is estimator


def log_predictions(model: Model, theta: Array, motions: Motions) -> dict[str, LogPrediction]:
    """Return the prediction of each log with theta (p); InputError where one has no usable sample."""
    predictions = {}
    for role, by_name in motions.items():
        for name, smoothed_motion in by_name.items():
            if not smoothed_motion.mask.any():
                raise InputError(f"{name}: no usable sample is left; exclude less, or smooth less.")
            motion = model.remembering(smoothed_motion)
            parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
            torque = np.concatenate([model.torque(**motion.states(part), theta=theta) for part in parts])
            error, by_joint = relative_errors(motion, torque)
            predictions[name] = LogPrediction(
                name, "train" if role == "train" else "validation", motion, torque, error, by_joint
            )
    return predictions


def quick_fit(
    problem: Problem,
    estimator: Estimator,
    folds: Sequence[TriangularFactors],
    factors: TriangularFactors,
    motions: Motions,
) -> QuickFit:
    """Return the fit of a problem with known factors: of the folds, and of all samples."""
    model = problem.model
    if factors.total <= len(model.parameters):
        raise InputError(
            f"{factors.samples} usable samples are too few for {len(model.parameters)} parameters; exclude less, or "
            "lower the minimum speed."
        )
    estimate, exact = quick_estimate(problem, estimator)
    squared_errors = prediction_errors(folds, folds, model.parameters, relative=False).sum(axis=0)
    size = np.square(factors.factors[:, :, -1]).sum(axis=1)
    by_joint = 100.0 * np.sqrt(np.divide(squared_errors, size, out=np.full_like(size, np.nan), where=size > 0))
    overall = 100.0 * float(np.sqrt(squared_errors.sum() / size.sum())) if size.any() else float("nan")
    return QuickFit(
        model,
        estimate,
        factors,
        log_predictions(model, estimate.value, motions),
        overall,
        {joint.name: float(error) for joint, error in zip(model.joints, by_joint, strict=True)},
        exact,
    )
