"""A Kalman filter in square-root form, for a batch of pieces: P = S S' is never formed, so it stays positive definite.

M. Verhaegen and P. Van Dooren (1986), "Numerical aspects of different Kalman filter implementations".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["corrected", "lower", "points"]

Array = NDArray[np.float64]


def lower(rows: Array) -> Array:
    """Return S (B, L, L), lower triangular, with S S' = A A' for ``rows`` A (B, L, K)."""
    found = np.asarray(np.linalg.qr(np.swapaxes(rows, 1, 2), mode="r"))
    return np.asarray(np.swapaxes(found, 1, 2))


def corrected(x: Array, S: Array, y: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Return the state x (B, L) and S (B, L, L) after measuring its first n entries as y (B, n), with the standard
    deviations ``sigma`` (n); and the innovations (B, n), white and of variance one where the filter is right."""
    n, size = y.shape[1], x.shape[1]
    before = np.zeros((len(x), n + size, n + size))
    before[:, range(n), range(n)] = sigma
    before[:, :n, n:], before[:, n:, n:] = S[:, :n], S
    after = lower(before)
    white: Array = np.asarray(np.linalg.solve(after[:, :n, :n], (y - x[:, :n])[..., None]), dtype=np.float64)
    return x + (after[:, n:, :n] @ white)[..., 0], after[:, n:, n:], white[..., 0]


def points(x: Array, S: Array) -> Array:
    """Return the 2 L points (B, 2 L, L) of the cubature rule, all of equal weight (Arasaratnam and Haykin, 2009)."""
    columns = np.sqrt(x.shape[1]) * np.swapaxes(S, 1, 2)
    return np.concatenate([x[:, None] + columns, x[:, None] - columns], axis=1)
