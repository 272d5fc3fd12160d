"""Triangular factors of the linear problem, one per joint: all that least squares needs of any number of rows.

Only the entries of a ``Structure`` are factorised, block by block (TSQR); the columns that they determine follow at the
end.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from functools import cache, cached_property
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.models import Structure
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

PANEL_COLUMNS = 8  # columns that LAPACK eliminates together
MERGED_AT_ONCE = 16  # factors that are merged at once


class EntryBlock(Noun):
    """Some rows of the problem: the ``entries`` (M, B) of a ``structure``, ``tau`` (n, B), and which of the rows to
    use, ``keep`` (n, B) or all."""

    structure: Structure
    entries: Array
    tau: Array
    keep: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        shapes = self.entries.shape, self.tau.shape
        if shapes != ((len(self.structure.joint), self.tau.shape[1]), (len(self.structure.columns), shapes[0][1])):
            raise ValueError(f"the shapes {shapes} of entries and torque must match each other and the structure.")

    def joint_rows(self, joint: int) -> Array:
        """Return the rows (b_j + 1, B) of [Y_j | tau_j]' of a joint, zero where they are not to be used; a new
        array."""
        part = self.structure.parts[joint]
        out = np.empty((part.stop - part.start + 1, self.tau.shape[1]))
        out[:-1], out[-1] = self.entries[part], self.tau[joint]
        if self.keep is not None:
            out *= self.keep[joint]
        return out

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which rows (n, B) to use."""
        return np.ones(self.tau.shape, dtype=bool) if self.keep is None else self.keep

    def take(self, samples: NDArray[np.bool_]) -> EntryBlock:
        """Return the block with these of its samples (B) only."""
        keep = None if self.keep is None else self.keep[:, samples]
        return EntryBlock(self.structure, self.entries[:, samples], self.tau[:, samples], keep)

    def scale_rows(self, weight: Array) -> EntryBlock:
        """Return the block with each row multiplied by its weight (n, B)."""
        return EntryBlock(self.structure, self.entries * weight[self.structure.joint], self.tau * weight, self.keep)

    def torque(self, theta: Array) -> Array:
        """Return Y theta (n, B) for theta (p)."""
        parts = zip(self.structure.parts, self.structure.maps, strict=True)
        return np.stack([(columns @ theta) @ self.entries[part] for part, columns in parts])

    def regressor(self, directions: Array | None = None) -> Array:
        """Return Y (B, n, p), or Y times ``directions`` (p, k)."""
        maps = self.structure.maps if directions is None else [columns @ directions for columns in self.structure.maps]
        return np.stack(
            [self.entries[part].T @ columns for part, columns in zip(self.structure.parts, maps, strict=True)], 1
        )


class TriangularFactors(Noun):
    """The sufficient statistics of least squares for any number of rows: per joint the R factor of [Y_j | tau_j].

    ``factors`` (n, p + 1, p + 1), upper triangular; ``rows`` (n) is the number of rows behind each of them.
    """

    factors: Array
    rows: NDArray[np.int_]

    @cached_property
    def cache(self) -> dict[Any, Any]:
        """Results that were computed from these factors, by what was asked for."""
        return {}

    @property
    def samples(self) -> int:
        """The largest number of rows of a joint."""
        return int(self.rows.max())

    @property
    def total(self) -> int:
        """The number of rows of all joints."""
        return int(self.rows.sum())

    def stack(self, weights: Array | None = None) -> Array:
        """Return one factor (p + 1, p + 1) of all joints, each multiplied by its weight (n), one over its noise."""
        factors = self.factors if weights is None else self.factors * np.asarray(weights)[:, None, None]
        if len(factors) == 1:
            return np.asarray(factors[0])
        # rows of zeros, of joints that a parameter does not act on, need no elimination
        rows = factors.reshape(-1, factors.shape[2])
        nonzero_rows, size = rows[rows.any(axis=1)], len(factors[0])
        with one_thread():
            factor: Array = np.asarray(np.linalg.qr(nonzero_rows, mode="r"))
        return np.concatenate([factor, np.zeros((size - len(factor), size))]) if len(factor) < size else factor

    def residual(self, theta: Array) -> Array:
        """Return the sum of squared residuals of each joint (n) at theta (p)."""
        return np.asarray(np.square(self.factors @ np.append(-theta, 1.0)).sum(axis=1))

    def subtract_torque(self, theta: Array) -> TriangularFactors:
        """Return the factors for the torque less that of theta (p)."""
        factors = self.factors.copy()
        factors[:, :, -1] -= self.factors[:, :, :-1] @ theta
        return TriangularFactors(factors, self.rows)


class Reduction:
    """Rows of a ``structure``, reduced to triangular factors as they come (TSQR): memory does not grow with them."""

    def __init__(self, structure: Structure) -> None:
        self._structure = structure
        self._factors = [np.zeros((len(columns) + 1,) * 2, order="F") for columns in structure.columns]
        self._count = np.zeros(len(structure.columns), dtype=int)

    def add(self, block: EntryBlock) -> None:
        """Reduce the factors so far and the rows of a block to one factor of each joint."""
        from scipy.linalg.lapack import dtpqrt

        for j, R in enumerate(self._factors):
            rows = block.joint_rows(j).T
            if len(R) < 2 * PANEL_COLUMNS:
                R[:] = np.linalg.qr(np.concatenate((R, rows)), mode="r")
            else:  # keeps R triangular, which is faster where there are more columns; the new R is in R
                dtpqrt(0, PANEL_COLUMNS, R, rows, overwrite_a=1, overwrite_b=1)
        self._count += block.used.sum(axis=1)

    def factors(self) -> TriangularFactors:
        """Return the factors of all columns, of which the independent ones alone were factorised."""
        factors = [
            _expand_columns(np.triu(R), columns) for R, columns in zip(self._factors, self._structure.maps, strict=True)
        ]
        return TriangularFactors(np.stack(factors), self._count)


def factorise(blocks: Iterable[EntryBlock], structure: Structure) -> TriangularFactors:
    """Reduce blocks to triangular factors as they come."""
    reduction = Reduction(structure)
    with one_thread():
        for block in blocks:
            if block.tau.size:
                reduction.add(block)
        return reduction.factors()


def _expand_columns(R: Array, columns: Array) -> Array:
    """Return the factor (p + 1, p + 1) of all columns from that (b + 1, b + 1) of the b that determine them.

    ``columns`` (b, p) makes all columns of these.
    """
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
    """The limit of BLAS to one thread, set by the first user and removed by the last."""

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


def merge_factors(parts: Iterable[TriangularFactors]) -> TriangularFactors:
    """Return the factors of the rows of all parts, of which there is at least one; they are taken as they come."""
    pending: list[TriangularFactors] = []
    for factors in parts:
        pending.append(factors)
        # merging a few at a time bounds the memory at little more work
        if len(pending) == MERGED_AT_ONCE:
            pending = [_merge_batch(pending)]
    return _merge_batch(pending)


def _merge_batch(parts: Sequence[TriangularFactors]) -> TriangularFactors:
    rows = np.concatenate([part.factors for part in parts], axis=1)
    with one_thread():
        factors = np.asarray(np.linalg.qr(rows, mode="r"))
    return TriangularFactors(factors, np.sum([part.rows for part in parts], axis=0))


def pack_factors(factors: TriangularFactors, structure: Structure) -> bytes:
    """Return the entries of factors that the structure allows to be nonzero, as bytes of float64."""
    return factors.factors[_nonzero_entries(structure)].tobytes()


def unpack_factors(content: bytes, rows: Sequence[int], structure: Structure) -> TriangularFactors:
    """Return the factors from the bytes of ``pack_factors``; ValueError where they are of another structure."""
    nonzero = _nonzero_entries(structure)
    entries = np.zeros(nonzero.shape)
    entries[nonzero] = np.frombuffer(content)
    return TriangularFactors(entries, np.array(rows, dtype=int))


def _nonzero_entries(structure: Structure) -> NDArray[np.bool_]:
    """Return which entries (n, p + 1, p + 1) of the factors can be other than zero."""
    p = structure.maps[0].shape[1]
    out = np.zeros((len(structure.maps), p + 1, p + 1), dtype=bool)
    for nonzero, columns in zip(out, structure.maps, strict=True):
        nonzero[: len(columns), :p] = columns.any(axis=0)
        nonzero[: len(columns), p] = nonzero[p, p] = True
        nonzero &= np.tri(p + 1, dtype=bool).T
    return out
