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


def calibration_std(lines: Sequence[Array], residuals: Sequence[Array], regression: Regression) -> Array:
    """Return the standard errors (k) of unknowns where residuals are correlated: of A^-1 S A^-1.

    ``lines`` (n, N, k) are the derivatives of the ``residuals`` (n, N) of each motion by the unknowns, from which all
    other parameters are eliminated; ``regression`` is that at their values. Infinite for unknowns without effect.
    """
    A = np.sum([np.einsum("jti,jtk->ik", line, line) for line in lines], axis=0)
    if not np.all(np.diag(A) > 0):
        return np.full(len(A), np.inf)
    S = long_run([np.einsum("jti,jt->ti", line, e) for line, e in zip(lines, residuals, strict=True)])
    # The other parameters took their share of the slow errors: the noise before that, as AR(1), may tell more.
    coloured = np.zeros_like(A)
    for j, (v, rho) in enumerate(_noise_of(regression)):
        for line in lines:
            sums = line[j].T @ one_pole_filter(rho, line[j].T).T
            coloured += v * (sums + sums.T - line[j].T @ line[j])
    inverse = np.linalg.pinv(A)
    return np.asarray(np.sqrt(np.maximum(*(np.diag(inverse @ part @ inverse) for part in (S, coloured)))))


def _noise_of(regression: Regression) -> Iterator[tuple[float, float]]:
    """Yield variance and correlation of neighbours of each joint's residual by least squares, none if not known."""
    factor, parameters = regression.triangular_factors.stack(), regression.model.parameters
    columns = base_parameters(factor, parameters).independent
    with suppress(ModelError, np.linalg.LinAlgError):  # nearly dependent columns
        fit = ColouredFit.of(regression, solve_least_squares(factor).value, None, columns)
        yield from zip(fit.v.tolist(), fit.rho.tolist(), strict=True)
