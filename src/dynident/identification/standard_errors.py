"""The standard errors of an estimate, and which of its parameters the data determine."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.estimators import Estimate
from dynident.estimators.least_squares import weighted
from dynident.identification.joint_knowledge import joint_knowledge
from dynident.identification.result import Identifiability, StandardErrors
from dynident.identification.time_offset import TimeOffset
from dynident.models import Model
from dynident.regression import (
    BaseParameters,
    Regression,
    base_parameters,
    base_std,
    compare,
    informed_std,
    structural_base_parameters,
)
from dynident.validation import correlated_std, plain_std

__all__ = ["covariance_of_time_offset", "identifiability_of"]

Array = NDArray[np.float64]
SHORT = 1e-4  # s, to differentiate by the time offset


def covariance_of_time_offset(
    model: Model, regression: Regression, estimate: Estimate, found: TimeOffset | None
) -> Array:
    """Return what the standard error of a time offset adds to the covariance (p, p) of the parameters."""
    p = len(model.parameters)
    if found is None or not found.seconds or found.std is None:
        return np.zeros((p, p))
    torques = []
    for motion in regression.motions:
        ends = [motion.shifted(side * SHORT) for side in (1.0, -1.0)]
        late, early = (model.torque(**one.states(), theta=estimate.value) for one in ends)
        torques.append((late - early)[:, :, None] / (2 * SHORT))
    weights, follows = estimate.residual.weights, estimate.residual.responding(regression)
    ones = np.ones(len(model.joints)) if weights is None else weights
    _, rank = weighted(follows.triangular_factors, ones, model.parameters, shown=estimate.shown)
    moved = found.std * rank.inverse @ follows.pulls(torques, weights)
    return np.asarray(moved @ moved.T)


def identifiability_of(
    model: Model,
    regression: Regression,
    estimate: Estimate,
    more: Array,
    progress: Callable[[str], None],
    robust: Callable[..., Array] = correlated_std,
    unfitted: Collection[str] = (),
) -> tuple[StandardErrors, Identifiability]:
    """Return the standard errors, and base parameters where not all parameters are determined.

    ``more`` (p, p) is the covariance by the errors of the motion and of its time offset; ``robust`` gives the standard
    errors that allow for correlated residuals, as ``correlated_std`` does; what only the torques of ``unfitted`` joints
    could show is not missed.
    """
    correlated = partial(_robust_std, regression, estimate, more=more, correlated=robust)
    if estimate.determined.rank == len(model.parameters):
        wide, every = correlated(estimate.std), list(range(len(more)))
        joint = joint_knowledge(regression, estimate, every, more, estimate.std if wide is None else wide, robust)
        return StandardErrors(estimate.std, wide, None, None, *joint), Identifiability()
    progress("finding base parameters")
    shown = estimate.determined.directions  # where the estimator says them, so that both have one rank
    on_data = base_parameters(
        regression.triangular_factors.stacked(estimate.residual.weights) if shown is None else shown, model.parameters
    )
    structural = structural_base_parameters(model, unfitted=unfitted)
    missing = compare(structural, on_data, model, regression.motions)
    own = _base_std(on_data, regression, estimate)
    wide = correlated(own, basis=on_data)
    std_hac = None if wide is None else _of_determined(on_data, wide)
    B, best = on_data.combination, own if wide is None else wide
    joint = joint_knowledge(regression, estimate, list(on_data.independent), B @ more @ B.T, best, robust)
    return StandardErrors(estimate.std, std_hac, own, wide, *joint), Identifiability(on_data, structural, missing)


def _base_std(basis: BaseParameters, regression: Regression, estimate: Estimate) -> Array:
    if estimate.information is None:
        triangular, residual = regression.triangular_factors, estimate.residual
        std = base_std(basis, triangular, residual.row_deviation(triangular, estimate.value), residual.weights)
    else:
        std = informed_std(basis, estimate.information)
    return np.hypot(std, _moved(estimate, basis))


def _robust_std(
    regression: Regression,
    estimate: Estimate,
    own: Array,
    more: Array,
    correlated: Callable[..., Array],
    basis: BaseParameters | None = None,
) -> Array | None:
    """Return standard errors that allow for correlated residuals, and for ``more`` (p, p), the covariance of the rest.

    Where the estimator counts the errors of the motion, its ``own`` are made larger in the ratio of those of least
    squares, to these at most; where they allow for correlation already, they stay.
    """
    B = np.eye(len(more)) if basis is None else basis.combination
    others = np.sqrt(np.einsum("ij,jk,ik->i", B, more, B))
    if estimate.residual.correlated:
        return np.asarray(np.hypot(own, others))
    columns = None if basis is None else basis.independent
    value, weights, slopes = estimate.value, estimate.residual.weights, estimate.residual.slopes
    try:
        robust = correlated(regression, value, weights, columns, slopes)
    except ModelError:  # nearly dependent columns: then there is no such figure
        return None
    if estimate.information is not None and weights is not None:  # that of the fit, as far as residuals are correlated
        alone = plain_std(regression, value, weights, range(len(value)) if columns is None else columns)
        robust = np.minimum(own * np.maximum(robust / alone, 1.0), np.maximum(robust, own))
    return np.asarray(np.hypot(np.hypot(robust, others), _moved(estimate, basis)))


def _moved(estimate: Estimate, basis: BaseParameters | None) -> Array:
    """Return what constraints moved the parameters by, or the base parameters; it may be an error of theirs."""
    free = estimate.consistency.unconstrained if estimate.consistency else None
    moved = np.zeros_like(estimate.value) if free is None else estimate.value - free
    return moved if basis is None else basis.to_base(moved)


def _of_determined(basis: BaseParameters, std: Array) -> Array:
    """Return standard errors (p) of the standard parameters that are base parameters by themselves, else infinite."""
    found = np.full(len(basis.names), np.inf)
    for k, row, value in zip(basis.independent, basis.combination, std, strict=True):
        if np.count_nonzero(row) == 1:
            found[k] = value
    return found
