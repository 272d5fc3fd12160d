"""Triangular factors of the linear problem, one per joint: all that least squares needs of any number of rows.

Only the entries of a ``Structure`` are factorised, block by block (TSQR); the columns that they determine follow at the
end.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache, cached_property
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models import Structure

__all__ = ["EntryBlock", "TriangularFactors", "factorise", "one_thread"]

Array = NDArray[np.float64]
PANEL = 8  # columns that LAPACK eliminates together


@dataclass(frozen=True, eq=False)
class EntryBlock:
    """Some rows of the problem: the ``entries`` (M, B) of a ``structure``, ``tau`` (n, B), and which of the rows to
    use, ``keep`` (n, B) or all."""

    structure: Structure
    entries: Array
    tau: Array
    keep: NDArray[np.bool_] | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        shapes = self.entries.shape, self.tau.shape
        if shapes != ((len(self.structure.joint), self.tau.shape[1]), (len(self.structure.columns), shapes[0][1])):
            raise ValueError(f"the shapes {shapes} of entries and torque must match each other and the structure.")

    def used(self, joint: int) -> Array:
        """Return the rows (b_j + 1, B) of [Y_j | tau_j]', zero where they are not to be used; a new array."""
        part = self.structure.parts[joint]
        out = np.empty((part.stop - part.start + 1, self.tau.shape[1]))
        out[:-1], out[-1] = self.entries[part], self.tau[joint]
        if self.keep is not None:
            out *= self.keep[joint]
        return out

    def times(self, weight: Array) -> EntryBlock:
        """Return the block with each row multiplied by its weight (n, B)."""
        return EntryBlock(self.structure, self.entries * weight[self.structure.joint], self.tau * weight, self.keep)

    def torque(self, theta: Array) -> Array:
        """Return Y theta (n, B) for theta (p)."""
        parts = zip(self.structure.parts, self.structure.maps, strict=True)
        return np.stack([(one @ theta) @ self.entries[part] for part, one in parts])

    def regressor(self, directions: Array | None = None) -> Array:
        """Return Y (B, n, p), or Y times ``directions`` (p, k)."""
        maps = self.structure.maps if directions is None else [one @ directions for one in self.structure.maps]
        return np.stack([self.entries[part].T @ one for part, one in zip(self.structure.parts, maps, strict=True)], 1)


@dataclass(frozen=True, eq=False)
class TriangularFactors:
    """The sufficient statistics of least squares for any number of rows: per joint the R factor of [Y_j | tau_j].

    ``factors`` (n, p + 1, p + 1), upper triangular; ``rows`` (n) is the number of rows behind each of them.
    """

    factors: Array
    rows: NDArray[np.int_]

    __repr__ = brief

    @cached_property
    def known(self) -> dict[Any, Any]:
        """What is known of these factors from before, by what was asked."""
        return {}

    @property
    def samples(self) -> int:
        """The largest number of rows of a joint."""
        return int(self.rows.max())

    @property
    def total(self) -> int:
        """The number of rows of all joints."""
        return int(self.rows.sum())

    def stacked(self, weights: Array | None = None) -> Array:
        """Return one factor (p + 1, p + 1) of all joints, each multiplied by its weight (n) (one over its noise)."""
        factors = self.factors if weights is None else self.factors * np.asarray(weights)[:, None, None]
        if len(factors) == 1:
            return np.asarray(factors[0])
        rows = factors.reshape(-1, factors.shape[2])
        some, size = rows[rows.any(axis=1)], len(factors[0])
        with one_thread():
            found: Array = np.asarray(np.linalg.qr(some, mode="r"))
        return np.concatenate([found, np.zeros((size - len(found), size))]) if len(found) < size else found

    def residual(self, theta: Array) -> Array:
        """Return the sum of squared residuals of each joint (n) at theta (p)."""
        return np.asarray(np.square(self.factors @ np.append(-theta, 1.0)).sum(axis=1))

    def less(self, theta: Array) -> TriangularFactors:
        """Return the factors of the torque less that of theta (p)."""
        factors = self.factors.copy()
        factors[:, :, -1] -= self.factors[:, :, :-1] @ theta
        return TriangularFactors(factors, self.rows)


def factorise(blocks: Iterable[EntryBlock], structure: Structure) -> TriangularFactors:
    """Reduce blocks to triangular factors, merging as they come: memory does not grow with the rows."""
    from scipy.linalg.lapack import dtpqrt

    sizes = [len(one) + 1 for one in structure.columns]
    found = [np.zeros((size, size), order="F") for size in sizes]
    count = np.zeros(len(sizes), dtype=int)
    with one_thread():
        for block in (one for one in blocks if one.tau.size):
            for j, (R, size) in enumerate(zip(found, sizes, strict=True)):
                rows = block.used(j).T
                if size < 2 * PANEL:
                    R[:] = np.linalg.qr(np.concatenate((R, rows)), mode="r")
                else:  # keeps R triangular, which is faster where there are more columns; the new R is in R
                    dtpqrt(0, PANEL, R, rows, overwrite_a=1, overwrite_b=1)
            count += block.tau.shape[1] if block.keep is None else block.keep.sum(axis=1)
        factors = [_expanded(np.triu(R), one) for R, one in zip(found, structure.maps, strict=True)]
    return TriangularFactors(np.stack(factors), count)


def _expanded(R: Array, columns: Array) -> Array:
    """Return the factor (p + 1, p + 1) of all columns, from that (b + 1, b + 1) of b that determine them by (b, p)."""
    b, p = columns.shape
    out = np.zeros((p + 1, p + 1))
    out[:b] = np.linalg.qr(np.concatenate([R[:b, :b] @ columns, R[:b, b:]], axis=1), mode="r")
    out[p, p] = R[b, b]
    return out


@cache
def _controller() -> Any:
    import scipy.linalg  # noqa: F401  # SciPy's own BLAS must be loaded to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


class _OneThread:
    """The limit of BLAS to one thread, set by the first who asks for it and taken back by the last."""

    def __init__(self) -> None:
        self._lock, self._users = Lock(), 0
        self._limit: Any = None

    def __enter__(self) -> None:
        with self._lock:
            self._users += 1
            if self._users == 1:
                self._limit = _controller().limit(limits=1, user_api="blas")

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._users -= 1
            if not self._users:
                self._limit.restore_original_limits()


_ONE_THREAD = _OneThread()


def one_thread() -> AbstractContextManager[None]:
    """Limit BLAS to one thread: with several, the many small factorisations run several times slower."""
    return _ONE_THREAD
