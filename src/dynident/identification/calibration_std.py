"""Standard errors of what is found before a fit (time offset, tilt) where residuals are correlated in time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from dynident.estimators.least_squares import solve_least_squares
from dynident.motion.filters import one_pole_filter
from dynident.regression import Regression, base_parameters
from dynident.regression.whitening import long_run
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array
from dynident.validation import ColouredFit

MIN_EFFECT = 1e-9  # of the torque (norm), by a change of one rad or s: less is rounding
MIN_EIGENVALUE = 1e-10  # of columns of norm one, as a share of the largest: directions below it cannot be told


def calibration_std(
    lines: Sequence[Array], residuals: Sequence[Array], regression: Regression, weights: Array | None = None
) -> Array:
    """Return the standard errors (k) of unknowns where residuals are correlated: of A^-1 S A^-1.

    ``lines`` (n, N, k) are the derivatives of the ``residuals`` (n, N) of each motion by the unknowns, from which all
    other parameters are eliminated, both times the ``weights`` (n, by default one) of the joints; ``regression`` is
    that at their values, without weights. Infinite for unknowns without effect.
    """
    w = np.ones(len(regression.model.joints)) if weights is None else weights
    size = np.sqrt(np.sum([np.square(line).sum(axis=(0, 1)) for line in lines], axis=0))
    torque = np.sqrt(sum(float(np.sum((w * motion.tau[motion.mask]) ** 2)) for motion in regression.motions))
    acts = size > MIN_EFFECT * torque
    std = np.full(len(size), np.inf)
    if not acts.any():
        return std
    lines = [line[..., acts] / size[acts] for line in lines]
    A = np.sum([np.einsum("jti,jtk->ik", line, line) for line in lines], axis=0)
    S = long_run([np.einsum("jti,jt->ti", line, e) for line, e in zip(lines, residuals, strict=True)])
    # The other parameters took their share of the slow errors: the noise before that, as AR(1), may tell more.
    coloured = np.zeros_like(A)
    for j, (v, rho) in enumerate(_noise_of(regression)):
        for line in lines:
            sums = line[j].T @ one_pole_filter(rho, line[j].T).T
            coloured += w[j] ** 2 * v * (sums + sums.T - line[j].T @ line[j])
    inverse = np.linalg.pinv(A, rcond=MIN_EIGENVALUE, hermitian=True)
    variances = [np.diag(inverse @ part @ inverse) for part in (S, coloured)]
    std[acts] = np.sqrt(np.maximum(np.max(variances, axis=0), 0.0)) / size[acts]
    return std


def _noise_of(regression: Regression) -> Iterator[tuple[float, float]]:
    """Yield variance and correlation of neighbours of each joint's residual by least squares, none if not known."""
    factor, parameters = regression.triangular_factors.stack(), regression.model.parameters
    columns = base_parameters(factor, parameters).independent
    with suppress(ModelError, np.linalg.LinAlgError):  # nearly dependent columns
        fit = ColouredFit.of(regression, solve_least_squares(factor).value, None, columns)
        yield from zip(fit.v.tolist(), fit.rho.tolist(), strict=True)
