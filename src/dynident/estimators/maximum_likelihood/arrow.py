"""Normal equations of arrow shape: a band for the trajectory, bordered by the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.sparse import csr_array

from dynident.errors import ModelError

__all__ = ["Arrow", "gather", "overlap"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]
JITTER = (0.0, 1e-13, 1e-10)  # added to the unit diagonal where rounding makes the factorisation fail


def overlap(first: Index, w: int, size: int) -> csr_array:
    """Return the sums (size, I w) over blocks (I) of w rows each, block i at the unknowns first[i] + (0 ... w - 1)."""
    place = (first[:, None] + np.arange(w)).ravel()
    rows = np.arange(len(place) + 1)
    return csr_array((np.ones(len(place)), place, rows), shape=(len(place), size)).T.tocsr()


def gather(blocks: Array, rows: Array, adds: csr_array) -> tuple[Array, Array]:
    """Add up overlapping blocks (I, w, w) and their rows (I, w, b), ``adds`` as :func:`overlap` has it.

    Returns the band (w, size) of the lower triangle, as LAPACK stores it, and the rows (size, b).
    """
    count, w = blocks.shape[:2]
    across, down = np.meshgrid(np.arange(w), np.arange(w))
    below = blocks[:, np.minimum(across + down, w - 1), down]
    below[:, across + down >= w] = 0.0
    out = adds @ np.concatenate([below, rows], axis=2).reshape(count * w, -1)
    return out[:, :w].T, out[:, w:]


@dataclass(frozen=True, eq=False)
class Arrow:
    """The symmetric matrix [[N, B], [B', D]]: ``band`` (w, m) is the lower band of N, ``border`` B (m, b).

    Only N must be positive definite; ModelError where it is not.
    """

    band: Array
    border: Array

    @cached_property
    def _factor(self) -> tuple[Array, Array]:
        """The Cholesky factor of N with a unit diagonal, and the scale (m) that gave it one."""
        diagonal = self.band[0]
        if not (diagonal > 0).all() or not np.isfinite(self.band).all():
            raise ModelError("a part of the trajectory is not determined by the recording.")
        scale = 1.0 / np.sqrt(diagonal)
        m = len(scale)
        scaled = self.band * scale
        for d in range(len(scaled)):
            scaled[d, : m - d] *= scale[d:]
            scaled[d, m - d :] = 0.0
        for extra in JITTER:
            scaled[0] = 1.0 + extra
            factor, failed = dpbtrf(scaled, lower=1)
            if not failed:
                return factor, scale
        raise ModelError("the normal equations of the trajectory are not positive definite.")

    def inner(self, rhs: Array) -> Array:
        """Return N^-1 rhs for rhs (m, k)."""
        factor, scale = self._factor
        found, _ = dpbtrs(factor, rhs * scale[:, None], lower=1)
        return np.asarray(found * scale[:, None])

    @cached_property
    def border_solution(self) -> Array:
        """N^-1 B (m, b): the dependence of the trajectory on the border."""
        return self.inner(self.border)

    @property
    def profiled(self) -> Array:
        """B' N^-1 B (b, b): the border's information lost to the unknown trajectory."""
        found = self.border.T @ self.border_solution
        return np.asarray((found + found.T) / 2)

    @cached_property
    def inverse(self) -> Array:
        """The band of N^-1, stored like N's: Takahashi's recursion, from the last column to the first."""
        factor, scale = self._factor
        w, m = factor.shape
        out = np.zeros((w, m))
        window = np.zeros((w, w))  # N^-1 at the unknowns i + 1 ... i + w
        for i in range(m - 1, -1, -1):
            pivot, below = factor[0, i], factor[1:, i] / factor[0, i]
            column = -window[:-1, :-1] @ below
            window[1:, 1:] = window[:-1, :-1].copy()
            window[0, 0] = 1.0 / pivot**2 - below @ column
            window[0, 1:] = window[1:, 0] = column
            out[:, i] = window[:, 0]
        for d in range(w):
            out[d, : m - d] *= scale[: m - d] * scale[d:]
        return out

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of N."""
        factor, scale = self._factor
        return float(2 * (np.log(factor[0]) - np.log(scale)).sum())
