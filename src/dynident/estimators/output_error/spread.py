"""The covariance of the slope J' e of a fit whose residuals are correlated in time, between joints, and unevenly large."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.output_error.linear import Linear, normal, root
from dynident.regression.long_run import bandwidth, bartlett

__all__ = ["information_of"]

Array = NDArray[np.float64]
ALONE = 1e6  # condition above which a piece alone determines a direction
LEAST = 1e-6  # variance of J' e over that of white residuals: below are exact data
PIECES = 10  # from which on what each piece adds is compared


def information_of(linear: Sequence[Linear]) -> Array:
    """Return the inverse covariance (r, r) of a fit, H S^-1 H with H = J' J and the covariance S of J' e.

    Of many pieces S is the scatter of what each adds; of few, such as a closed loop, it is the long-run covariance. In
    units of white residuals, correlations between directions count as far as there are more pieces, or independent
    samples, than directions.
    """
    H, _ = normal(linear)
    half, pieces = root(H), sum(len(one.rows) for one in linear)
    total, independent = _of_pieces(linear, H) if pieces >= PIECES else _of_samples(linear)
    white = np.linalg.solve(half, np.linalg.solve(half, total).T)
    r, rest = len(H), np.diag(np.maximum(np.diag(white), LEAST))
    spread = half @ ((independent * white + r * rest) / (independent + r)) @ half.T
    found = np.linalg.solve(root(spread), H)
    samples = sum(one.samples for one in linear)
    return np.asarray(max(samples - r, 1) / max(samples, 1) * found.T @ found)


def _of_pieces(linear: Sequence[Linear], H: Array) -> tuple[Array, float]:
    """Return S (r, r) of pieces, each of which is correlated as it will, and their number: what the fit changes by when
    each is left out (the jackknife; Bell and McCaffrey, 2002)."""
    total, count = np.zeros_like(H), 0
    for one in linear:
        scores = np.einsum("bkr,bk->br", one.rows, one.rest)
        left = np.eye(len(H)) - (one.rows.transpose(0, 2, 1) @ one.rows) @ np.linalg.pinv(H, hermitian=True)
        known = np.linalg.cond(left) < ALONE
        scores[known] = np.linalg.solve(left[known], scores[known][..., None])[..., 0]
        total, count = total + scores.T @ scores, count + len(scores)
    return total, float(count)


def _of_samples(linear: Sequence[Linear]) -> tuple[Array, float]:
    """Return S (r, r) by the long-run covariance of each stretch, and the number of independent samples."""
    H, _ = normal(linear)
    half, total, independent = root(H), np.zeros_like(H), 0.0
    for one in linear:
        scores = (one.rows * one.rest[..., None]).reshape(-1, one.joints, len(H)).sum(axis=1)
        scores = np.linalg.solve(half, scores.T).T  # so that all columns count alike
        length = bandwidth(iter([iter([scores])]))
        count, part = bartlett(iter([scores]), length, len(H))
        total, independent = total + part, independent + count / length
    return half @ total @ half.T, independent
