"""How strongly the robot file's inertias count beside the data: chosen by cross-validation on the training logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, Severity
from dynident.estimators import Estimator, PhysicallyConsistent, Problem, quick
from dynident.identification.cross_validation import Gain, factors_of, gained
from dynident.identification.time_offset import trial_samples
from dynident.log import Motion, thinned
from dynident.models import Model
from dynident.regression import Regression, merged

__all__ = ["PriorStrength", "find_prior_strength", "with_strength"]

Array = NDArray[np.float64]
FOLDS = 6
ROWS = 3  # times the parameters: with fewer there is nothing to predict
STRENGTHS = (1e-2, 1e-1)  # of the squared residual, where a parameter is one usual size away
LEAST = 1.0  # % of the squared cross-validated error that a strength must remove


@dataclass(frozen=True)
class PriorStrength(Note):
    """The ``strength`` of the prior that is used, and the ``gain`` of the best one in cross-validation."""

    severity: ClassVar[Severity] = Severity.INFO
    strength: float
    gain: Gain


def find_prior_strength(
    model: Model,
    motions: Sequence[Motion],
    estimator: Estimator,
    min_speed: tuple[float, ...] | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> PriorStrength | None:
    """Return the strength with the least cross-validated error, 0 unless it gains more than one standard error and 1 %.

    Stretches of time are predicted from the others by the estimator. None where it has no strength that is to be
    chosen, there is no inertia in the robot file, or there are too few samples. Raises the errors of
    ``Regression`` and the estimator.
    """
    if not isinstance(estimator, PhysicallyConsistent) or estimator.strength != "auto" or not estimator.inertia:
        return None
    known = any(one.role == "mass" and (one.value or 0.0) > 0 for one in model.parameters)
    if estimator.prior != "nominal" or not known:
        return None
    progress("choosing the strength of the prior")
    thin = thinned(motions, trial_samples(model))
    parts = factors_of(model, thin, FOLDS, min_speed)
    if sum(one.total for one in parts) < ROWS * len(model.parameters):
        return None

    rows = None if estimator.fit is None else quick(estimator.fit)

    def errors(strength: float) -> Array:
        """Return the squared errors (folds, n) of each fold, predicted from the others."""
        fit, found = replace(estimator, strength=strength, costs=False, fit=rows), []
        for k, part in enumerate(parts):
            others = merged([*parts[:k], *parts[k + 1 :]])
            regression = Regression(model, thin, None, min_speed).with_factors(others)
            found.append(part.residual(fit(Problem(model, thin, regression)).value))
        return np.stack(found)

    plain = errors(0.0)
    gains = {strength: gained(plain, errors(strength)) for strength in STRENGTHS}
    best = max(gains, key=lambda one: gains[one].share)
    return PriorStrength(best if gains[best].sure and gains[best].share > LEAST else 0.0, gains[best])


def with_strength(estimator: Estimator, found: PriorStrength | None) -> Estimator:
    """Return the estimator with the strength that was found."""
    if found is None or not isinstance(estimator, PhysicallyConsistent):
        return estimator
    return replace(estimator, strength=found.strength)
