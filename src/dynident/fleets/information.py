"""What one log alone says of the base parameters: their values, the information on them, and what they leave."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.least_squares import joint_weights, weighted
from dynident.estimators.linear import solve
from dynident.identification import Identification
from dynident.regression import BaseParameters, Regression, TriangularFactors, base_parameters
from dynident.validation import robust_covariance

__all__ = ["information_of"]

Array = NDArray[np.float64]
ITERATIONS = 3  # of the weights of the joints


def information_of(found: Identification, basis: BaseParameters) -> tuple[Array, Array, Array]:
    """Return base parameters (b) by least squares on the training logs of an identification, the information (b, b) on
    them, the inverse of their covariance, zero in directions that the logs do not show, and the residual.

    The residual (n) is the root mean square of the torque (N m, N) that these parameters leave of each joint, with
    their degrees of freedom; nan where no row of a joint is in use.

    Nothing else than the logs counts: no prior, no constraint; joints are weighted by their residuals. With R the
    triangular factor of the columns in use, R = U S V', the errors of S V' beta are independent where residuals are
    white; their variances v, at least 1, are those of correlated residuals (``robust_covariance``), and the information
    is V S diag(1 / v) S V'. Raises ModelError where the motion shows too little to tell.
    """
    model, recipe = found.model, found.recipe
    motions = tuple(one.motion for one in found.validations if one.role == "train")
    speeds = recipe.min_speeds([joint.name for joint in model.joints])
    residual = found.estimate.residual
    plain = Regression(model, motions, recipe.filter, speeds)
    regression = residual.weighted(plain)
    triangular, parameters = regression.triangular_factors, model.parameters
    weights = joint_weights(triangular, "per_joint", ITERATIONS, parameters)
    value = solve(*weighted(triangular, weights, parameters)).value
    shown = base_parameters(triangular.stacked(weights), parameters)
    kept = list(shown.independent)
    covariance = robust_covariance(regression, value, weights, kept, residual.slopes)
    factor = np.linalg.qr(triangular.stacked(weights)[:, kept], mode="r")
    scale = np.linalg.norm(factor, axis=0)
    _, size, axes = np.linalg.svd(factor / scale)
    to_axes = size[:, None] * axes * scale
    variance = np.maximum(np.einsum("ij,jk,ik->i", to_axes, covariance, to_axes), 1.0)
    half = (to_axes / np.sqrt(variance)[:, None]) @ shown.combination[:, list(basis.independent)]
    left = triangular if residual.whitening is None else plain.triangular_factors
    return basis.to_base(value), half.T @ half, _left(left, value, len(kept))


def _left(triangular: TriangularFactors, value: Array, rank: int) -> Array:
    """Return the residual (n) of the torque, the rank spread over all rows."""
    rows = np.where(triangular.rows > 0, triangular.rows, np.nan)
    share = 1 - rank / triangular.total
    return np.asarray(np.sqrt(triangular.residual(value) / (share * rows))) if share > 0 else np.full(len(rows), np.nan)
