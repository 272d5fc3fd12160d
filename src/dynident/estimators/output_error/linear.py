"""A simulation linearised by the parameters and by the states at the start of its pieces, which are eliminated.

The rows of a piece are [J_theta | J_start] and its residual e: with A = J_start' J_start the start that fits best
follows from theta, and what is left of J_theta is orthogonal to J_start. Both are damped alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Linear", "linearised", "normal", "root"]

Array = NDArray[np.float64]
RIDGE = 1e-12  # of the start: a joint that rests has no sensitivity


@dataclass(frozen=True, eq=False)
class Linear:
    """A stretch around its simulation: weighted ``rows`` of theta (B, K n, r) and ``starts`` (B, K n, 2 n) of unit
    columns, which were ``size`` (B, 2 n) times as long; ``rest`` (B, K n) are the residuals, of which so many
    ``samples`` count."""

    rows: Array
    starts: Array
    size: Array
    rest: Array
    samples: int

    __repr__ = brief

    @cached_property
    def _products(self) -> tuple[Array, Array]:
        """J_start' J_start (B, 2 n, 2 n), and J_start' [J_theta | e] (B, 2 n, r + 1)."""
        turned = self.starts.transpose(0, 2, 1)
        return turned @ self.starts, np.concatenate((turned @ self.rows, turned @ self.rest[..., None]), axis=2)

    @cached_property
    def _whole(self) -> Array:
        """[J_theta | e]' [J_theta | e] (r + 1, r + 1)."""
        J, e = self.rows.reshape(-1, self.rows.shape[2]), self.rest.ravel()
        slope = J.T @ e
        return np.block([[J.T @ J, slope[:, None]], [slope, e @ e]])

    def _followed(self, damping: float) -> Array:
        """Return the starts (B, 2 n, r + 1) that follow from a step of theta, and from the residuals (last column)."""
        A, known = self._products
        return np.asarray(np.linalg.solve(A + (RIDGE + damping) * np.eye(A.shape[1]), known))

    def normal(self, damping: float) -> Array:
        """Return [J_theta | e]' [J_theta | e] (r + 1, r + 1) of what the starts leave."""
        _, known = self._products
        return np.asarray(self._whole - np.einsum("bsi,bsj->ij", known, self._followed(damping)))

    def moved(self, step: Array, damping: float) -> Array:
        """Return by what the starts (B, 2 n) move with a step of theta (r)."""
        both = self._followed(damping)
        return np.asarray((both[..., -1] - both[..., :-1] @ step) / self.size)

    @property
    def left(self) -> tuple[Array, Array]:
        """The rows (B, K n, r) and residuals (B, K n) without what the starts can explain."""
        both = self._followed(0.0)
        explained = self.starts @ both[..., :-1]
        return np.subtract(self.rows, explained, out=explained), self.rest - (self.starts @ both[..., -1:])[..., 0]


def linearised(by_theta: Array, by_start: Array, e: Array, count: Array, sigma: Array) -> Linear:
    """Return the rows of derivatives (B, K, n, r) and (B, K, n, 2 n), and of residuals e (B, K, n) of which those with
    ``count`` 1 are there, in units of ``sigma`` (n). The derivatives are overwritten."""
    some = count[0].any(axis=1)
    if len(e) == 1 and not some.all():  # samples that do not count would hide that the others are correlated
        by_theta, by_start, e = by_theta[:, some], by_start[:, some], e[:, some]
    pieces = len(e)
    for one in (by_theta, by_start):
        one /= sigma.reshape(-1, 1)
    J, S = (one.reshape(pieces, -1, one.shape[3]) for one in (by_theta, by_start))
    size = np.linalg.norm(S, axis=1)
    size = np.where(size > 0, size, 1.0)
    S = np.divide(S, size[:, None], out=S)
    return Linear(J, S, size, (e / sigma).reshape(pieces, -1), int(count.sum()))


def normal(linear: Sequence[Linear], damping: float = 0.0) -> tuple[Array, Array]:
    """Return J' J (r, r) and J' e (r) of what the starts leave of all stretches."""
    total = np.asarray(sum(one.normal(damping) for one in linear))
    return total[:-1, :-1], total[:-1, -1]


def root(matrix: Array) -> Array:
    """Return the Cholesky factor (r, r), of a singular matrix that of one near to it."""
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    some = matrix / np.outer(scale, scale)
    return np.asarray(scale[:, None] * np.linalg.cholesky(some + 1e-13 * len(some) * np.eye(len(some))))
