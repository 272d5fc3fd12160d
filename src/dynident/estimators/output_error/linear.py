"""A simulation linearised by the parameters; the states at the start of each piece are eliminated.

The rows of a piece are [J_theta | J_start] and its residual e: with A = J_start' J_start the start that fits best
follows from theta, and what is left of J_theta is orthogonal to J_start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Linear", "linearised", "normal", "root"]

Array = NDArray[np.float64]
RIDGE = 1e-12  # of the start: a joint that rests has no sensitivity


@dataclass(frozen=True, eq=False)
class Linear:
    """A stretch around its simulation: what is left of the weighted rows of theta (B, K n, r) and of the residuals
    (B, K n), of which so many ``samples`` count, and what the starts (B, 2 n) follow: ``start`` = at theta as it is,
    ``follow`` (B, 2 n, r) by a step of theta."""

    rows: Array
    rest: Array
    start: Array
    follow: Array
    samples: int

    __repr__ = brief

    @property
    def joints(self) -> int:
        """How many joints there are."""
        return self.start.shape[1] // 2


def linearised(by_theta: Array, by_start: Array, e: Array, count: Array, sigma: Array) -> Linear:
    """Return the rows without the starts: derivatives (B, K, n, r) and (B, K, n, 2 n), residuals e (B, K, n) of which
    those with ``count`` 1 are there, in units of ``sigma`` (n)."""
    pieces, scale = len(e), sigma.reshape(-1, 1)
    J, S = ((one / scale).reshape(pieces, -1, one.shape[3]) for one in (by_theta, by_start))
    known = np.concatenate((J, (e / sigma).reshape(pieces, -1, 1)), axis=2)
    size = np.linalg.norm(S, axis=1, keepdims=True)
    size = np.where(size > 0, size, 1.0)
    S = S / size
    A = S.transpose(0, 2, 1) @ S + RIDGE * np.eye(S.shape[2])
    both = np.linalg.solve(A, S.transpose(0, 2, 1) @ known)
    left, starts = known - S @ both, both / size.transpose(0, 2, 1)
    return Linear(left[..., :-1], left[..., -1], starts[..., -1], starts[..., :-1], int(count.sum()))


def normal(linear: Sequence[Linear]) -> tuple[Array, Array]:
    """Return J' J (r, r) and J' e (r) of all stretches."""
    r = linear[0].rows.shape[2]
    J = [one.rows.reshape(-1, r) for one in linear]
    e = [one.rest.ravel() for one in linear]
    pairs = list(zip(J, e, strict=True))
    return np.asarray(sum(one.T @ one for one in J)), np.asarray(sum(one.T @ rest for one, rest in pairs))


def root(matrix: Array) -> Array:
    """Return the Cholesky factor (r, r), of a singular matrix that of one near to it."""
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    some = matrix / np.outer(scale, scale)
    return np.asarray(scale[:, None] * np.linalg.cholesky(some + 1e-13 * len(some) * np.eye(len(some))))
