"""The covariance of the slope J' e of a fit whose residuals are correlated in time and between joints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.output_error.linear import Linear, root
from dynident.regression.long_run import bandwidth, bartlett

__all__ = ["information_of"]

Array = NDArray[np.float64]
ALONE = 1e6  # condition above which a piece alone determines a direction
LEAST = 1e-6  # variance of J' e over that of white residuals: below are exact data
AT_ONCE = 4096  # samples
PIECES = 3  # from which on what each segment adds is compared


def information_of(linear: Sequence[Linear], joints: int) -> Array:
    """Return the inverse covariance (r, r) of a fit, H S^-1 H with H = J' J and the covariance S of J' e.

    Of segments S is the scatter of what each adds, in a closed loop it is the long-run covariance. In units of white
    residuals, correlations between directions count as far as there are more segments, or independent samples, than
    directions.
    """
    left = [one.left for one in linear]
    H = np.asarray(sum(J.reshape(-1, J.shape[2]).T @ J.reshape(-1, J.shape[2]) for J, _ in left))
    half, r = root(H), len(H)
    segments = max(len(J) for J, _ in left) > 1 and sum(len(J) for J, _ in left) >= PIECES
    white, independent = _of_pieces(left, half) if segments else _of_samples(left, half, joints)
    rest = np.diag(np.maximum(np.diag(white), LEAST))
    spread = half @ ((independent * white + r * rest) / (independent + r)) @ half.T
    found = np.linalg.solve(root(spread), H)
    samples = sum(one.samples for one in linear)
    return np.asarray(max(samples - r, 1) / max(samples, 1) * found.T @ found)


def _of_pieces(left: Sequence[tuple[Array, Array]], half: Array) -> tuple[Array, float]:
    """Return S in units of H = half half' (r, r) of pieces, each of which is correlated as it will, and their number:
    what the fit changes by when each is left out (the jackknife; MacKinnon and White, 1985)."""
    total, count = np.zeros_like(half), 0
    for rows, e in left:
        for some in _blocks(len(rows), max(AT_ONCE // rows.shape[1], 1)):
            J = np.linalg.solve(half, rows[some].reshape(-1, len(half)).T).T.reshape(rows[some].shape)
            scores = np.einsum("bkr,bk->br", J, e[some])
            others = np.eye(len(half)) - J.transpose(0, 2, 1) @ J
            known = np.linalg.cond(others) < ALONE
            scores[known] = np.linalg.solve(others[known], scores[known][..., None])[..., 0]
            total, count = total + scores.T @ scores, count + len(scores)
    return total, float(count)


def _of_samples(left: Sequence[tuple[Array, Array]], half: Array, joints: int) -> tuple[Array, float]:
    """Return S in units of H (r, r), the long-run covariance of each stretch, and how many samples are independent."""
    total, independent = np.zeros_like(half), 0.0
    for J, e in left:
        length = bandwidth(iter([_scores(J, e, half, joints, AT_ONCE)]))
        count, part = bartlett(_scores(J, e, half, joints, max(AT_ONCE, length)), length, len(half))
        total, independent = total + part, independent + count / length
    return total, independent


def _scores(J: Array, e: Array, half: Array, joints: int, size: int) -> Iterator[Array]:
    """Yield J_t' e_t of the samples in units of H, in blocks of that size."""
    rows, rest = J.reshape(-1, joints, J.shape[2]), e.reshape(-1, joints)
    for some in _blocks(len(rows), size):
        yield np.linalg.solve(half, np.einsum("kjr,kj->kr", rows[some], rest[some]).T).T


def _blocks(count: int, size: int) -> Iterator[slice]:
    """Yield so many in blocks of a size: a long recording has no room for copies of all its derivatives."""
    for first in range(0, count, size):
        yield slice(first, first + size)
