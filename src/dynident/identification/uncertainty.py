"""The standard errors of an estimate, and which of its parameters the data determine."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from dynident.estimators import Estimate
from dynident.estimators.least_squares import weight_joints
from dynident.identification.base_tilt import BaseTilt, tilt_slopes
from dynident.identification.result import Identifiability, StandardErrors
from dynident.identification.time_offset import TimeOffset
from dynident.models import Model
from dynident.regression import (
    BaseParameters,
    Regression,
    base_parameters,
    base_std,
    find_unexcited,
    informed_std,
    rank_of_information,
    structural_base_parameters,
)
from dynident.runtime import ModelError, report_progress
from dynident.runtime.arrays import Array
from dynident.validation import ColouredFit, correlated_std, plain_std, robust_covariance

RobustStd = Callable[..., Array]  # as ``correlated_std``
# of the data: residuals are allowed to be correlated as long, where white noise hides how long they are
MAX_LAG_SHARE = 0.025


@dataclass(frozen=True, eq=False)
class FitUncertainty:
    """The errors of an ``estimate`` from a ``regression``; ``robust`` gives those of correlated residuals."""

    regression: Regression
    estimate: Estimate
    robust: RobustStd = correlated_std

    def base_std(self, basis: BaseParameters) -> Array:
        """Return the standard errors (r) of base parameters for white residuals."""
        regression, estimate = self.regression, self.estimate
        if estimate.information is None:
            triangular, residual = regression.triangular_factors, estimate.residual
            std = base_std(basis, triangular, residual.row_deviation(triangular, estimate.value), residual.weights)
        else:
            std = informed_std(basis, estimate.information)
        return np.hypot(std, _constraint_shift(estimate, basis))

    def robust_std(self, std: Array, more: Array, basis: BaseParameters | None = None) -> Array:
        """Return standard errors for correlated residuals and ``more`` (p, p), the covariance by other errors.

        Where the estimator counts the errors of the motion, its ``std`` grow in the ratio of robust to white errors
        of least squares, to the robust ones at most; where they allow for correlation already, they stay. Where the
        columns are nearly dependent there are no robust figures, and ``std`` is returned.
        """
        regression, estimate = self.regression, self.estimate
        B = np.eye(len(more)) if basis is None else basis.combination
        extra_std = np.sqrt(np.einsum("ij,jk,ik->i", B, more, B))
        if estimate.residual.correlated:
            return np.asarray(np.hypot(std, extra_std))
        columns = None if basis is None else basis.independent
        value, weights, slopes = estimate.value, estimate.residual.weights, estimate.residual.slopes
        try:
            robust = self.robust(regression, value, weights, columns, slopes)
        except ModelError:  # nearly dependent columns
            return std
        # Scale by the ratio of robust to white errors: the estimator's own errors count more than least squares does.
        # that of the fit, as far as residuals are correlated
        if estimate.information is not None and weights is not None:
            white_std = plain_std(regression, value, weights, range(len(value)) if columns is None else columns)
            robust = np.minimum(std * np.maximum(robust / white_std, 1.0), np.maximum(robust, std))
        return np.asarray(np.hypot(np.hypot(robust, extra_std), _constraint_shift(estimate, basis)))

    def joint_knowledge(
        self, columns: list[int], extra_covariance: Array, std: Array
    ) -> tuple[Array, Array, Array, Array | None] | tuple[None, None, None, None]:
        """Return the covariance of the base parameters and how each joint contributes to them.

        Returns the covariance (r, r) of the base parameters led by the ``columns``, the parts (r, n) that the torque
        of each joint has in them, its share (n) in their errors, and (r, n) what friction abs(load_j) sign(dq_j) of
        each joint adds to them. All are None where the columns are dependent to working precision.

        With R = U S V' the triangular factor of the weighted columns, the errors of S V' beta are independent where
        residuals are white. Their variances v are those of correlated residuals (``robust``), so that the covariance
        is V S^-1 diag(v) S^-1 V' + ``extra_covariance`` (r, r): the estimated covariance itself, of few independent
        samples, would show directions that seem to be known without error. Where there is no such figure, all
        variances are larger by the median of those of ``std`` (r) over those for white residuals. A joint contributes
        (sum_j w_j^2 Y_j' Y_j)^-1 w_j^2 Y_j' tau_j; its share is the trace of the same with Y_j for tau_j, over r, and
        where rows are whitened, that of row j, what joint j tells beyond the joints after it. The load is the torque
        of the bodies; what it adds is None where there are none, or where the rows are not all at hand.
        """
        regression, estimate = self.regression, self.estimate
        triangular, n = regression.triangular_factors, len(regression.model.joints)
        w = np.ones(n) if estimate.residual.weights is None else np.asarray(estimate.residual.weights)
        # QR once more, without the torque column: only the geometry of the columns is needed here.
        factor = np.linalg.qr(triangular.stack(w)[:, columns], mode="r")
        scale = np.linalg.norm(factor, axis=0)
        _, size, axes = np.linalg.svd(factor / np.where(scale > 0, scale, 1.0))
        if not (scale > 0).all() or not size[-1] > np.finfo(float).eps * len(columns) * size[0]:
            return None, None, None, None
        # Maps to and from the principal axes of the scaled columns, in which white errors are independent.
        to_axes, back = size[:, None] * axes * scale, (axes / size[:, None]).T / scale[:, None]
        R = triangular.factors[:, :, columns]
        if regression.whitening is None:
            projections = np.einsum("j,jik,ji->kj", w**2, R, triangular.factors[:, :, -1])
        else:  # a row is not of one joint
            projections = regression.weighted_products(_fitted_torques(regression), w)[columns]
        shares = np.square(w[:, None, None] * (R @ back)).sum(axis=(1, 2)) / len(columns)
        # Extra covariance comes from errors of the motion, which the residual does not show.
        covariance = self._covariance(columns, to_axes, back, std) + extra_covariance
        load_projections = _load_projections(regression, estimate.value, w) if self.robust is correlated_std else None
        return (
            covariance,
            back @ (back.T @ projections),
            shares,
            None if load_projections is None else back @ (back.T @ load_projections[columns]),
        )

    def _covariance(self, columns: list[int], to_axes: Array, back: Array, std: Array) -> Array:
        """Return the covariance (r, r) of the columns; ``to_axes`` and ``back`` are maps to independent errors."""
        regression, estimate, robust = self.regression, self.estimate, self.robust
        if estimate.information is None and robust is correlated_std:
            weights, slopes = estimate.residual.weights, estimate.residual.slopes
            try:
                std = robust(regression, estimate.value, weights, columns, slopes, to_axes)
                long_lag = robust_covariance(regression, estimate.value, weights, columns, slopes, MAX_LAG_SHARE)
                # The larger of both: the automatic lag may be too short where white noise hides the correlation.
                std = np.maximum(std, np.sqrt(np.maximum(np.diag(to_axes @ long_lag @ to_axes.T), 0.0)))
                # Correlations between the axes from the coloured residual, variances from the robust figure.
                fit = ColouredFit.of(regression, estimate.value, weights, columns, slopes)
                coloured = to_axes @ fit.covariance @ to_axes.T
                half = back * (std / np.sqrt(np.diag(coloured)))
                return np.asarray(half @ coloured @ half.T)
            except (ModelError, np.linalg.LinAlgError):  # nearly dependent columns
                pass
        if estimate.information is not None:
            white = rank_of_information(estimate.information[np.ix_(columns, columns)]).inverse
        else:
            white = back @ back.T
        # No robust figure: scale the white covariance to the standard errors that are given.
        with np.errstate(divide="ignore"):
            ratio = std**2 / np.diag(white)
        finite_ratios = ratio[np.isfinite(ratio)]
        return np.asarray(white * (np.median(finite_ratios) if len(finite_ratios) else 1.0))


def _fitted_torques(regression: Regression) -> list[Array]:
    """Return the fitted torque (N, n, n) of each motion, that of joint j in column j."""
    model, bias = regression.model, regression.bias
    bias_torques = [
        0.0 if bias is None else model.torque(**motion.states(), theta=bias) for motion in regression.motions
    ]
    eye = np.eye(len(model.joints))
    return [(motion.tau - x)[:, :, None] * eye for motion, x in zip(regression.motions, bias_torques, strict=True)]


def _load_projections(regression: Regression, theta: Array, weights: Array) -> Array | None:
    """Return sum_j w_j^2 Y_j' abs(load_j) sign(dq_j) (p, n), None where the model has no bodies."""
    is_body, torques = regression.model.load_mask, []
    if not is_body.any():
        return None
    bodies = regression.model.bodies
    for motion in regression.motions:
        friction = np.abs(bodies.torque(motion.q, motion.dq, motion.ddq, theta[is_body])) * np.sign(motion.dq)
        torques.append(friction[:, :, None] * np.eye(friction.shape[1]))
    return regression.weighted_products(torques, weights)


TIME_STEP = 1e-4  # s, to differentiate by the time offset


def covariance_of_calibration(
    model: Model, regression: Regression, estimate: Estimate, time_offset: TimeOffset | None, tilt: BaseTilt | None
) -> Array:
    """Return the covariance (p, p) of the parameters by the standard errors of the time offset and the base tilt.

    Where these were found to be zero, they count as known.
    """
    offset_std = time_offset.std or 0.0 if time_offset and time_offset.seconds else 0.0
    tilt_std = tilt.std if tilt and (tilt.x or tilt.y) else ()
    if not offset_std and not tilt_std:
        return np.zeros((len(model.parameters),) * 2)
    theta, torques = estimate.value, []
    # The torques that an offset and tilts of one standard error make are projected on the parameters.
    for motion in regression.motions:
        columns = [np.zeros_like(motion.q)]
        if offset_std:
            ends = [motion.shift(side * TIME_STEP) for side in (1.0, -1.0)]
            forward, backward = (model.torque(**shifted.states(), theta=theta) for shifted in ends)
            columns.append(offset_std * (forward - backward) / (2 * TIME_STEP))
        if tilt_std:
            pairs = zip(tilt_slopes(model, motion, theta), tilt_std, strict=True)
            columns += [slope * std for slope, std in pairs if np.isfinite(std)]
        torques.append(np.stack(columns, axis=2))
    weights, follows = estimate.residual.weights, estimate.residual.weight_by_slopes(regression)
    ones = np.ones(len(model.joints)) if weights is None else weights
    _, rank = weight_joints(
        follows.triangular_factors, ones, model.parameters, unwhitened_rank=estimate.unwhitened_rank
    )
    parameter_changes = rank.inverse @ follows.weighted_products(torques, weights)
    return np.asarray(parameter_changes @ parameter_changes.T)


def identifiability_of(
    regression: Regression,
    estimate: Estimate,
    extra_covariance: Array,
    robust: RobustStd = correlated_std,
    unfitted: Collection[str] = (),
) -> tuple[StandardErrors, Identifiability]:
    """Return the standard errors, and the base parameters where not all parameters are determined.

    ``extra_covariance`` (p, p) is that by errors of the motion, its time offset and the base tilt. ``robust`` gives the
    standard errors that allow for correlated residuals, as ``correlated_std`` does. What only the torques of
    ``unfitted`` joints could show does not count as missing.
    """
    model, fit = regression.model, FitUncertainty(regression, estimate, robust)
    if estimate.determined.rank == len(model.parameters):
        all_columns, std = list(range(len(extra_covariance))), fit.robust_std(estimate.std, extra_covariance)
        joint = fit.joint_knowledge(all_columns, extra_covariance, std)
        return StandardErrors(std, estimate.std, None, None, *joint), Identifiability()
    report_progress("finding base parameters")
    directions = estimate.determined.directions  # where the estimator says them, so that both have one rank
    on_data = base_parameters(
        regression.triangular_factors.stack(estimate.residual.weights) if directions is None else directions,
        model.parameters,
    )
    structural = structural_base_parameters(model, unfitted=unfitted)
    missing = find_unexcited(structural, on_data, model, regression.motions)
    base_std_independent = fit.base_std(on_data)
    base_std, B = fit.robust_std(base_std_independent, extra_covariance, on_data), on_data.combination
    # parameters that are base parameters by themselves have the standard errors of these
    std = estimate.std
    for k, row, value in zip(on_data.independent, B, base_std, strict=True):
        if np.count_nonzero(row) == 1:
            std[k] = value
    joint = fit.joint_knowledge(list(on_data.independent), B @ extra_covariance @ B.T, base_std)
    errors = StandardErrors(std, estimate.std, base_std, base_std_independent, *joint)
    return errors, Identifiability(on_data, structural, missing)


def _constraint_shift(estimate: Estimate, basis: BaseParameters | None) -> Array:
    """Return the change of the parameters, or base parameters, by constraints: it may be an error of theirs."""
    unconstrained = estimate.consistency.unconstrained if estimate.consistency else None
    shift = np.zeros_like(estimate.value) if unconstrained is None else estimate.value - unconstrained
    return shift if basis is None else basis.to_base(shift)
