"""Standard errors for residuals that are correlated in any way within parts of the data, and not between them.

The scores u_k of the parts, sum_j w_j^2 Y_j' e_j over the samples of each, follow from their triangular factors alone:
the fit to any number of samples needs no second pass. Liang and Zeger (1986), "Longitudinal data analysis using
generalized linear models".
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ModelError
from dynident.regression import Regression, TriangularFactors
from dynident.validation.hac import bread

__all__ = ["clustered_std"]

Array = NDArray[np.float64]


def clustered_std(
    parts: Callable[[], Iterable[TriangularFactors]],
    regression: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None = None,
    columns: Sequence[int] | None = None,
    _: Sequence[Array] = (),
) -> Array:
    """Return the standard errors (r) of a least-squares fit: the roots of the diagonal of A^-1 S A^-1, in SI units.

    ``parts`` gives the factors of all K parts of the ``regression``; the other arguments are those of
    ``robust_covariance``. A = sum w_j^2 Y_j' Y_j, S = K / (K - 1) sum_k u_k u_k'. Parts should be longer than what
    correlates, and 40 or more. Raises ModelError where columns are dependent or there are fewer than two parts.
    """
    value = np.asarray(theta, dtype=float) + (0.0 if regression.bias is None else regression.bias)
    kept = list(range(len(value))) if columns is None else list(columns)
    w = np.ones(len(regression.model.joints)) if weights is None else np.asarray(weights, dtype=float)
    scale, inverse = bread(regression, w, kept)
    residual, total, count = np.append(-value, 1.0), np.zeros((len(kept), len(kept))), 0
    for one in parts():
        score = np.einsum("j,jik,ji->k", w**2, one.factors[:, :, kept], one.factors @ residual) / scale
        total, count = total + np.outer(score, score), count + bool(one.total)
    if count < 2:
        raise ModelError("the spread of the parts needs at least two of them.")
    return np.asarray(np.sqrt(count / (count - 1) * np.diag(inverse @ total @ inverse)) / scale)
