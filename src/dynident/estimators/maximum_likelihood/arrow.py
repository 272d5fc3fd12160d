"""Normal equations of arrow shape: a band for the trajectory, bordered by the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import as_strided, sliding_window_view
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpbtrs, dtbtrs

from dynident.errors import ModelError

__all__ = ["Arrow", "add_ahead", "add_rows", "band_of", "places"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]
JITTER = (0.0, 1e-13, 1e-10)  # added to the unit diagonal where rounding makes the factorisation fail


def places(first: Index, d: int) -> list[slice | Index]:
    """Return where rows first[i] + a of all i are, for a = 0 ... d - 1: ``first`` (I) rises, by one where it can."""
    if len(first) and first[-1] - first[0] == len(first) - 1:
        return [slice(int(first[0]) + a, int(first[-1]) + a + 1) for a in range(d)]
    return [first + a for a in range(d)]


def add_rows(total: Array, rows: Array, at: Sequence[slice | Index]) -> None:
    """Add the rows (I, d, ...) of blocks to ``total`` (m, ...), ``at`` their :func:`places`."""
    for a, there in enumerate(at):
        total[there] += rows[:, a]


def add_ahead(total: Array, blocks: Array, at: Sequence[slice | Index]) -> None:
    """Add symmetric blocks (I, d, n, d n) to ``total`` (m, n, d n): each unknown with its own block and those after."""
    n = total.shape[1]
    for a, there in enumerate(at):
        total[there, :, : (len(at) - a) * n] += blocks[:, a, :, a * n :]


def band_of(total: Array) -> Array:
    """Return the lower band (d n, m n), as LAPACK stores it, of what ``add_ahead`` has summed (m, n, d n)."""
    m, n, w = total.shape
    flat = np.concatenate([total.ravel(), np.zeros(w)])
    size = flat.itemsize
    band = as_strided(flat, (m, n, w), (n * w * size, (w + 1) * size, size)).copy()
    for j in range(1, n):
        band[:, j, w - j :] = 0.0
    return band.reshape(m * n, w).T


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
        w = len(self.band)
        ahead = sliding_window_view(np.concatenate([scale, np.zeros(w - 1)]), w)  # (m, w)
        scaled = (self.band.T * (ahead * scale[:, None])).T
        for extra in JITTER:
            scaled[0] = 1.0 + extra
            factor, failed = dpbtrf(scaled, lower=1)
            if not failed:
                return factor, scale
        raise ModelError("the normal equations of the trajectory are not positive definite.")

    def inner(self, rhs: Array) -> Array:
        """Return N^-1 rhs for rhs (m, k)."""
        factor, scale = self._factor
        found, _ = dpbtrs(factor, _scaled(rhs, scale), lower=1, overwrite_b=1)
        return np.asarray(found * scale[:, None])

    @cached_property
    def half(self) -> Array:
        """L^-1 B (m, b), where L L' = N."""
        factor, scale = self._factor
        return np.asarray(dtbtrs(factor, _scaled(self.border, scale), uplo="L", overwrite_b=1)[0])

    def back(self, half: Array) -> Array:
        """Return L'^-1 x for x (m, k), which makes N^-1 B of ``half``."""
        factor, scale = self._factor
        return np.asarray(dtbtrs(factor, half, uplo="L", trans="T")[0] * scale[:, None])

    @property
    def profiled(self) -> Array:
        """B' N^-1 B (b, b): the border's information lost to the unknown trajectory."""
        return np.asarray(self.half.T @ self.half)

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


def _scaled(rhs: Array, scale: Array) -> Array:
    """Return the rows of rhs (m, k) times the scale (m), column by column in memory, as LAPACK needs it."""
    return np.multiply(rhs, scale[:, None], order="F")
