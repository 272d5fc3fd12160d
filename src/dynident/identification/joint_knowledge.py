"""What a fit knows of all base parameters together: their covariance, and what the torque of each joint contributes, or
friction that grows with the load there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.estimators import Estimate
from dynident.models.memory import loading
from dynident.regression import Regression, rank_of_information
from dynident.validation import coloured_covariance, correlated_std, robust_covariance

__all__ = ["joint_knowledge"]

Array = NDArray[np.float64]
SHARE = 0.025  # of the data: residuals are allowed to be correlated as long, where white noise hides how long they are


def joint_knowledge(
    regression: Regression,
    estimate: Estimate,
    kept: list[int],
    more: Array,
    std: Array,
    robust: Callable[..., Array] = correlated_std,
) -> tuple[Array, Array, Array, Array | None] | tuple[None, None, None, None]:
    """Return the covariance (r, r) of the base parameters that the columns ``kept`` lead, (r, n) the parts that the
    torque of each joint has in them, its share (n) in their errors, and (r, n) what friction abs(load_j) sign(dq_j) of
    each joint adds to them; None where the columns are dependent to working precision.

    With R = U S V' the triangular factor of the weighted columns, the errors of S V' beta are independent where
    residuals are white. Their variances v are those of correlated residuals (``robust``), so that the covariance is
    V S^-1 diag(v) S^-1 V' + ``more`` (r, r): the estimated covariance itself, of few independent samples, would show
    directions that seem to be known without error. Where there is no such figure, all variances are larger by the
    median of those of ``std`` (r) over those for white residuals. A joint contributes
    (sum_j w_j^2 Y_j' Y_j)^-1 w_j^2 Y_j' tau_j; its share is the trace of the same with Y_j for tau_j, over r, and where
    rows are whitened, that of row j, what joint j tells beyond the joints after it. The load
    is the torque of the bodies; what it adds is None where there are none, or where the rows are not all at hand.
    """
    triangular, n = regression.triangular_factors, len(regression.model.joints)
    w = np.ones(n) if estimate.residual.weights is None else np.asarray(estimate.residual.weights)
    factor = np.linalg.qr(triangular.stacked(w)[:, kept], mode="r")
    scale = np.linalg.norm(factor, axis=0)
    _, size, axes = np.linalg.svd(factor / np.where(scale > 0, scale, 1.0))
    if not (scale > 0).all() or not size[-1] > np.finfo(float).eps * len(kept) * size[0]:
        return None, None, None, None
    to_axes, back = size[:, None] * axes * scale, (axes / size[:, None]).T / scale[:, None]
    if regression.whitening is None:
        pulls = np.einsum("j,jik,ji->kj", w**2, triangular.factors[:, :, kept], triangular.factors[:, :, -1])
    else:  # a row is not of one joint
        pulls = regression.pulls(_torques(regression), w)[kept]
    shares = np.square(w[:, None, None] * (triangular.factors[:, :, kept] @ back)).sum(axis=(1, 2)) / len(kept)
    covariance = _covariance(regression, estimate, kept, (to_axes, back), std, robust) + more
    by_load = _load_pulls(regression, estimate.value, w) if robust is correlated_std else None
    return covariance, back @ (back.T @ pulls), shares, None if by_load is None else back @ (back.T @ by_load[kept])


def _torques(regression: Regression) -> list[Array]:
    """Return the torque (N, n, n) that is fitted of each motion, that of joint j in column j."""
    model, bias = regression.model, regression.bias
    less = [0.0 if bias is None else model.torque(**one.states(), theta=bias) for one in regression.motions]
    eye = np.eye(len(model.joints))
    return [(one.tau - x)[:, :, None] * eye for one, x in zip(regression.motions, less, strict=True)]


def _load_pulls(regression: Regression, theta: Array, weights: Array) -> Array | None:
    """Return sum_j w_j^2 Y_j' abs(load_j) sign(dq_j) (p, n), None where the model has no bodies."""
    own, torques = loading(regression.model.terms), []
    if not own.any():
        return None
    bodies = regression.model.bodies
    for motion in regression.motions:
        friction = np.abs(bodies.torque(motion.q, motion.dq, motion.ddq, theta[own])) * np.sign(motion.dq)
        torques.append(friction[:, :, None] * np.eye(friction.shape[1]))
    return regression.pulls(torques, weights)


def _covariance(
    regression: Regression,
    estimate: Estimate,
    kept: list[int],
    turns: tuple[Array, Array],
    std: Array,
    robust: Callable[..., Array],
) -> Array:
    to_axes, back = turns
    if estimate.information is None and robust is correlated_std:
        weights, slopes = estimate.residual.weights, estimate.residual.slopes
        try:
            std = robust(regression, estimate.value, weights, kept, slopes, to_axes)
            slow = robust_covariance(regression, estimate.value, weights, kept, slopes, SHARE)
            std = np.maximum(std, np.sqrt(np.maximum(np.diag(to_axes @ slow @ to_axes.T), 0.0)))
            along = to_axes @ coloured_covariance(regression, estimate.value, weights, kept, slopes) @ to_axes.T
            half = back * (std / np.sqrt(np.diag(along)))
            return np.asarray(half @ along @ half.T)
        except (ModelError, np.linalg.LinAlgError):  # nearly dependent columns
            pass
    if estimate.information is not None:
        white = rank_of_information(estimate.information[np.ix_(kept, kept)]).inverse
    else:
        white = back @ back.T
    with np.errstate(divide="ignore"):
        ratio = std**2 / np.diag(white)
    known = ratio[np.isfinite(ratio)]
    return np.asarray(white * (np.median(known) if len(known) else 1.0))
