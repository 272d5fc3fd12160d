"""How much the robot file's inertias count beside the data: the strength of the prior, by cross-validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.estimators import Estimator, PhysicallyConsistent, Problem
from dynident.identification.cross_validation import Gain, factors_by_fold, gain_from_errors, gains_by_stretch
from dynident.identification.time_offset import trial_samples
from dynident.models import Model
from dynident.motion.log import Motion, thin_motions
from dynident.regression import EVERYTHING, Regression, Selection, merge_factors
from dynident.runtime import Note, Severity, report_progress
from dynident.runtime.arrays import Array

FOLDS = 6
MIN_ROWS_PER_PARAMETER = 3  # times the parameters: with fewer there is nothing to predict
STRENGTHS = (1e-2, 1e-1)  # of the squared residual, where a parameter is one usual size away
MIN_GAIN = 1.0  # % of the squared cross-validated error that a strength must remove


class PriorStrength(Note):
    """The ``strength`` of the prior that is used, and the ``gain`` of the best one in cross-validation."""

    severity = Severity.INFO
    strength: float
    gain: Gain

    def __str__(self) -> str:
        if not self.strength:
            return f"the robot file's inertias count only where the data show nothing: else {self.gain} gained"
        return f"the robot file's inertias count with a strength of {self.strength:g}, which gains {self.gain}"


def find_prior_strength(
    model: Model, motions: Sequence[Motion], estimator: Estimator, selection: Selection = EVERYTHING
) -> PriorStrength | None:
    """Find the strength of the prior with the least cross-validated error.

    It is 0 unless the gain exceeds one standard error, and 1 % without the stretch that gains the most. Stretches of
    time are predicted from the others by the estimator. None where it has no strength to choose, there is no inertia
    in the robot file, or there are too few samples. Raises the errors of ``Regression`` and the estimator.
    """
    if not isinstance(estimator, PhysicallyConsistent) or estimator.strength != "auto" or not estimator.inertia:
        return None
    has_nominal_mass = any(parameter.role == "mass" and (parameter.value or 0.0) > 0 for parameter in model.parameters)
    if estimator.prior != "nominal" or not has_nominal_mass:
        return None
    report_progress("choosing the strength of the prior")
    thin = thin_motions(motions, trial_samples(model))
    parts = factors_by_fold(model, thin, FOLDS, selection)
    if sum(fold.total for fold in parts) < MIN_ROWS_PER_PARAMETER * len(model.parameters):
        return None

    # The costs and a slow inner fit do not change which strength predicts best.
    rows = estimator.linear.quick()

    def errors(strength: float) -> Array:
        """Return the squared errors (folds, n) of each fold, predicted from the others."""
        fit, fold_errors = replace(estimator, strength=strength, fit=rows), []
        for k, part in enumerate(parts):
            train_factors = merge_factors([*parts[:k], *parts[k + 1 :]])
            regression = Regression(model, thin, selection.unfiltered).with_factors(train_factors)
            fold_errors.append(part.residual(fit.torque_value(Problem(model, thin, regression))))
        return np.stack(fold_errors)

    # The plain error is shared by all gains: without a prior, least squares with constraints.
    plain = errors(0.0)
    errors_by_strength, gains = dict[float, Array](), dict[float, Gain]()
    for strength in STRENGTHS:
        # gains grow at most in proportion to the strength: where even that would not suffice, no stronger one is tried
        if any(gain.share * strength / weaker < MIN_GAIN for weaker, gain in gains.items()):
            break
        errors_by_strength[strength] = errors(strength)
        gains[strength] = gain_from_errors(plain, errors_by_strength[strength])
    best = max(gains, key=lambda candidate: gains[candidate].share)
    # a single stretch, where the others excite little, is no evidence
    stretches = gains_by_stretch(plain, errors_by_strength[best])
    holds = stretches.sum() - stretches.max() > MIN_GAIN
    return PriorStrength(best if gains[best].sure and holds else 0.0, gains[best])


def with_strength(estimator: Estimator, prior: PriorStrength | None) -> Estimator:
    """Return the estimator with the strength that was found."""
    if prior is None or not isinstance(estimator, PhysicallyConsistent):
        return estimator
    return replace(estimator, strength=prior.strength)
