"""The quick fit of a tuning, without the slow corrections: parameters, errors, torque measured and predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np

from dynident.estimators import Estimate, Estimator, PhysicallyConsistent, Problem
from dynident.identification.cross_validation import prediction_errors
from dynident.models import INERTIAL, Model
from dynident.motion.log import Motion
from dynident.regression import (
    BaseParameters,
    Regression,
    TriangularFactors,
    base_parameters,
    base_std,
    factorise,
    merge_factors,
)
from dynident.runtime import InputError, Noun, call_part
from dynident.runtime.arrays import Array
from dynident.validation import predict_torque, relative_errors

FOLDS = 5  # as many as a smoother is chosen by
Motions = Mapping[str, Mapping[str, Motion]]


def fold_factors(regression: Regression) -> tuple[TriangularFactors, ...]:
    """Return the factors of each of five stretches, with equal shares of the samples of each motion.

    Rows are filtered as in the whole, so that merging all gives its factors.
    """
    by_fold = []
    for k in range(FOLDS):
        parts = []
        for i, motion in enumerate(regression.motions):
            start, stop = _edges(motion)[k]
            parts.append(factorise(regression.entries(within=(i, slice(start, stop))), regression.model.structure))
        by_fold.append(merge_factors(parts))
    return tuple(by_fold)


def _edges(motion: Motion) -> list[tuple[int, int]]:
    """Return where the folds of a motion start and stop."""
    usable = np.flatnonzero(motion.mask)
    inner = [int(rows[0]) if len(rows) else len(motion) for rows in np.array_split(usable, FOLDS)[1:]]
    return list(pairwise([0, *inner, len(motion)]))


class LogPrediction(Noun):
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


class QuickFit(Noun):
    """The fit of a tuning with its ``model``: the ``estimate``, and ``logs`` by name, those of the training first.

    It lacks the correction of ``Bench.identify`` for the bias by errors of the motion, and its standard errors
    are those for independent residuals: true ones are larger. ``cross_validated`` (%) is the error of stretches
    of the training predicted from the others by least squares, over the torques that are fitted. ``exact`` is
    False where the estimator has been replaced by a faster one.
    """

    model: Model
    estimate: Estimate
    factors: TriangularFactors
    logs: Mapping[str, LogPrediction]
    cross_validated: float
    exact: bool

    @property
    def condition(self) -> float:
        """Ratio of the largest to the smallest singular value of the column-scaled regressor that counts: among the
        directions that the data determine."""
        return self.estimate.determined.determined_condition

    @cached_property
    def inertial_torque(self) -> Mapping[str, Array]:
        """The torque (N, n) of bodies and rotors alone, by log: what is left of the others is friction and offset."""
        roles = [parameter.role in (*INERTIAL, "rotor") for parameter in self.model.parameters]
        theta = np.where(roles, self.estimate.value, 0.0)
        return {name: predict_torque(self.model, log.motion, theta) for name, log in self.logs.items()}

    @cached_property
    def base(self) -> BaseParameters:
        """The base parameters on the data: combinations that are determined; each parameter itself where all are."""
        directions = self.estimate.determined.directions
        return base_parameters(
            self.factors.stack(self.estimate.residual.weights) if directions is None else directions,
            self.model.parameters,
        )

    @cached_property
    def base_std(self) -> Array:
        """Standard errors (r) of the base parameters for independent residuals."""
        residual = self.estimate.residual
        return base_std(self.base, self.factors, residual.sigma, residual.weights)


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
            torque = predict_torque(model, motion, theta)
            error, by_joint = relative_errors(motion, torque)
            predictions[name] = LogPrediction(
                name, "train" if role == "train" else "validation", motion, torque, error, by_joint
            )
    return predictions


def quick_fit(problem: Problem, estimator: Estimator, folds: Sequence[TriangularFactors], motions: Motions) -> QuickFit:
    """Return the fit of a problem whose regression has the merged factors of the ``folds``."""
    model, factors = problem.model, problem.regression.triangular_factors
    if factors.total <= len(model.parameters):
        raise InputError(
            f"{factors.samples} usable samples are too few for {len(model.parameters)} parameters; exclude less, or "
            "lower the minimum speed."
        )
    estimate, exact = quick_estimate(problem, estimator)
    squared_error = prediction_errors(folds, folds, model.parameters, relative=False).sum()
    size = np.square(factors.factors[:, :, -1]).sum()
    cross_validated = 100.0 * float(np.sqrt(squared_error / size)) if size else float("nan")
    predictions = log_predictions(model, estimate.value, motions)
    return QuickFit(model, estimate, factors, predictions, cross_validated, exact)
