"""What a tuning gives, without the corrections that take long: parameters, errors, torque measured and predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief, called
from dynident.estimators import Estimate, Estimator, PhysicallyConsistent, Problem, quick
from dynident.identification.cross_validation import predicted
from dynident.log import Motion
from dynident.models import Model
from dynident.regression import BLOCK, BaseParameters, TriangularFactors, base_parameters, base_std
from dynident.validation import relative_errors

__all__ = ["LogFit", "QuickFit", "estimated", "log_fits", "quick_fit"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Motions = Mapping[str, Mapping[str, Motion]]


@dataclass(frozen=True, eq=False)
class LogFit:
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
    def fitted(self) -> Mask:
        """Which torques (N, n) are fitted: none of a held-out log."""
        keep = np.ones(self.motion.q.shape, dtype=bool) if self.motion.keep is None else self.motion.keep
        return np.asarray(self.motion.mask[:, None] & keep & (self.role == "train"))


@dataclass(frozen=True, eq=False)
class QuickFit:
    """The fit of a tuning, by its ``model``: the ``estimate``, and ``logs`` by name, those of the training first.

    It differs from ``Bench.whole`` by the bias that errors of the motion make, which is not corrected here, and in
    standard errors, which are those of independent residuals: true ones are larger. ``cross_validated`` (%) is the
    error of stretches of the training predicted from the others by least squares, over the torques that are fitted,
    and ``cross_validated_by_joint`` that of each, nan where nothing is fitted. ``exact`` is False where the estimator
    has been replaced by a faster one. ``seconds`` is how long it took.
    """

    model: Model
    estimate: Estimate
    factors: TriangularFactors
    logs: Mapping[str, LogFit]
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
    def known(self) -> Mask:
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
            self.factors.stacked(self.estimate.residual.weights) if directions is None else directions,
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

    def held_out(self) -> Mapping[str, LogFit]:
        """Return the held-out logs by name."""
        return {name: one for name, one in self.logs.items() if one.role == "validation"}


def estimated(problem: Problem, estimator: Estimator) -> tuple[Estimate, bool]:
    """Return the estimate without what takes long, and whether it is that of the estimator itself."""
    if isinstance(estimator, PhysicallyConsistent):
        fit = None if estimator.fit is None else quick(estimator.fit)
        return called(replace(estimator, costs=False, fit=fit), problem, Estimate), fit is estimator.fit
    fast = quick(estimator)
    return called(fast, problem, Estimate), fast is estimator


def log_fits(model: Model, theta: Array, motions: Motions) -> dict[str, LogFit]:
    """Return the torque of each log by the parameters theta (p). Raises InputError where a log has no usable sample."""
    found = {}
    for role, some in motions.items():
        for name, one in some.items():
            if not one.mask.any():
                raise InputError(f"{name}: no usable sample is left; exclude less, or smooth less.")
            motion = model.remembering(one)
            parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
            torque = np.concatenate([model.torque(**motion.states(part), theta=theta) for part in parts])
            error, by_joint = relative_errors(motion, torque)
            found[name] = LogFit(name, "train" if role == "train" else "validation", motion, torque, error, by_joint)
    return found


def quick_fit(
    problem: Problem,
    estimator: Estimator,
    folds: Sequence[TriangularFactors],
    whole: TriangularFactors,
    motions: Motions,
) -> QuickFit:
    """Return the fit of a problem whose factors are known, in folds and in all."""
    model = problem.model
    if whole.total <= len(model.parameters):
        raise InputError(
            f"{whole.samples} usable samples are too few for {len(model.parameters)} parameters; exclude less, or "
            "lower the minimum speed."
        )
    estimate, exact = estimated(problem, estimator)
    wrong = predicted(folds, folds, model.parameters, relative=False).sum(axis=0)
    size = np.square(whole.factors[:, :, -1]).sum(axis=1)
    by_joint = 100.0 * np.sqrt(np.divide(wrong, size, out=np.full_like(size, np.nan), where=size > 0))
    overall = 100.0 * float(np.sqrt(wrong.sum() / size.sum())) if size.any() else float("nan")
    return QuickFit(
        model,
        estimate,
        whole,
        log_fits(model, estimate.value, motions),
        overall,
        {joint.name: float(one) for joint, one in zip(model.joints, by_joint, strict=True)},
        exact,
    )
