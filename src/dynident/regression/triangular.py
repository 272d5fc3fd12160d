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

from dynident.models import INERTIAL, Parameter, Structure
from dynident.runtime import ConfigError, Noun
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


def factorise(blocks: Iterable[EntryBlock], structure: Structure) -> TriangularFactors:
    """Reduce blocks to triangular factors, merging them as they come: memory does not grow with the rows."""
    from scipy.linalg.lapack import dtpqrt

    sizes = [len(columns) + 1 for columns in structure.columns]
    factors_so_far = [np.zeros((size, size), order="F") for size in sizes]
    count = np.zeros(len(sizes), dtype=int)
    with one_thread():
        # TSQR: the factor so far and the rows of a block are reduced to one factor
        for block in (columns for columns in blocks if columns.tau.size):
            for j, (R, size) in enumerate(zip(factors_so_far, sizes, strict=True)):
                rows = block.joint_rows(j).T
                if size < 2 * PANEL_COLUMNS:
                    R[:] = np.linalg.qr(np.concatenate((R, rows)), mode="r")
                else:  # keeps R triangular, which is faster where there are more columns; the new R is in R
                    dtpqrt(0, PANEL_COLUMNS, R, rows, overwrite_a=1, overwrite_b=1)
            count += block.used.sum(axis=1)
        # the independent columns alone were factorised; all others follow from them
        factors = [
            _expand_columns(np.triu(R), columns) for R, columns in zip(factors_so_far, structure.maps, strict=True)
        ]
    return TriangularFactors(np.stack(factors), count)


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


ANGLES = 1e-5  # rad: precision of the angles in robot files; the error of 3.1416 is 7e-6
ARITHMETIC = 1e-12  # double precision, after sums over many rows
SQUARED = 1e-12  # the same for an information matrix, which squares all ratios
MAX_EMPTY_RATIO = 1e-14  # a column this small relative to the largest is rounding error
TIE_LIMITS = (1e-6, 1e-2)  # entries of the projector on the undetermined space above which two parameters are tied
KINDS = (INERTIAL[:1], INERTIAL[1:4], INERTIAL[4:])  # mass, first and second moments: of one unit each


class Rank(Noun):
    """The ``rank`` r of a factor, and the directions of the parameters (p) that it determines and leaves free.

    ``scale`` (p) divides the factor's columns; ``values`` (p) are the singular values of the scaled factor, in
    descending order, with their ``left_vectors`` (p, p) and right ``vectors`` (p, p) as columns. Values below
    ``tolerance`` times the largest count as zero. ``unweighted`` is the rank without weights of the rows, where there
    are any.
    """

    rank: int
    scale: Array
    values: Array
    left_vectors: Array
    vectors: Array
    tolerance: float
    unweighted: Rank | None = None

    @property
    def determined_directions(self) -> Array:
        """Directions (p, r) that act on the torque, in the parameters' units."""
        return self.vectors[:, : self.rank] / self.scale[:, None]

    @property
    def free_directions(self) -> Array:
        """Directions (p, p - r) that do not act on the torque, in the parameters' units."""
        return self.vectors[:, self.rank :] / self.scale[:, None]

    @property
    def condition(self) -> float:
        """Ratio of the largest to the smallest of all singular values, inf where one is zero."""
        with np.errstate(over="ignore"):
            return float(self.values[0] / self.values[-1]) if len(self.values) and self.values[-1] > 0 else np.inf

    @cached_property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Sets of parameters of which only combinations are identifiable; single ones have no effect."""
        if self.rank == len(self.values):
            return ()
        null = self.vectors[:, self.rank :]
        return tuple(map(tuple, tied_groups(null @ null.T, self._tie)))

    @property
    def undetermined_mask(self) -> NDArray[np.bool_]:
        """Whether each parameter (p) is in one of the groups, so that the data do not determine its value."""
        out = np.zeros(len(self.values), dtype=bool)
        out[[k for group in self.groups for k in group]] = True
        return out

    @property
    def _tie(self) -> float:
        return float(np.clip(100 * self.tolerance, *TIE_LIMITS))

    def spanning_directions(self, axes: NDArray[np.bool_]) -> Array:
        """Return orthonormal directions (p, v) that span the determined ones and the parameters ``axes`` (p)."""
        alone = axes | ~self.undetermined_mask
        tied = np.flatnonzero(~alone)
        # of the tied parameters, the directions that have a share in the determined ones
        rotation, share, _ = np.linalg.svd(self.vectors[tied, : self.rank], full_matrices=False)
        mixed = rotation[:, share**2 > self._tie] / self.scale[tied, None]
        out = np.zeros((len(alone), mixed.shape[1]))
        out[tied] = np.linalg.qr(mixed)[0]
        return np.concatenate([np.eye(len(alone))[:, alone], out], axis=1)

    @property
    def inverse(self) -> Array:
        """(X' X)^-1 on the determined directions, (p, p), in the parameters' units."""
        # the inverse by its square root, so that the condition is not squared
        half = self.determined_directions / self.values[: self.rank]
        return np.asarray(half @ half.T)

    def covariance(self, variance: float = 1.0) -> Array:
        """Return ``variance`` times the inverse, with infinite variances of undetermined parameters."""
        undetermined = self.undetermined_mask
        out = np.where(undetermined | undetermined[:, None], 0.0, variance * self.inverse)
        out[undetermined, undetermined] = np.inf
        return out

    def with_information(self, information: Array) -> Rank:
        """Return the rank of an information matrix (p, p) on the determined directions; the others remain free."""
        directions = self.vectors[:, : self.rank]
        squares, turn = np.linalg.eigh(directions.T @ (information / np.outer(self.scale, self.scale)) @ directions)
        squares, turn = squares[::-1], turn[:, ::-1]
        values = np.concatenate([np.sqrt(np.maximum(squares, 0.0)), np.zeros(len(self.scale) - self.rank)])
        vectors = np.concatenate([directions @ turn, self.vectors[:, self.rank :]], axis=1)
        retained = int((squares > SQUARED * squares[0]).sum()) if self.rank and squares[0] > 0 else 0
        return Rank(retained, self.scale, values, vectors, vectors, self.tolerance, self.unweighted)


def tied_groups(projector: Array, limit: float) -> list[list[int]]:
    """Return the sets of rows that a projector ties together, by entries above a limit."""
    from scipy.sparse.csgraph import connected_components

    tied = np.abs(projector) > limit
    _, label = connected_components(tied, directed=False)
    return [np.flatnonzero(label == group).tolist() for group in sorted(set(label[tied.any(axis=1)]))]


def precision(parameters: Sequence[Parameter]) -> float:
    """Return the relative precision of a model's regressor: that of a robot file, or double precision."""
    return ANGLES if any(x.role in INERTIAL for x in parameters) else ARITHMETIC


def rank_of(
    factor: Array, parameters: Sequence[Parameter] = (), tolerance: float | None = None, unweighted: Rank | None = None
) -> Rank:
    """Return the rank of a triangular factor, (p, p) or with the torque (p + 1, p + 1), of a regressor.

    ``tolerance``: share of the largest singular value that counts as zero; None takes the ``precision`` of the
    parameters (double precision where they are not given). Weights of the rows amplify rounding together with small
    effects, so that they must not decide: with ``unweighted``, the rank without weights, only what is below double
    precision is dropped in addition. Raises ConfigError for a tolerance outside (0, 1).
    """
    if tolerance is not None and not 0 < tolerance < 1:
        raise ConfigError(f"tolerance of the rank is {tolerance}; give a number between 0 and 1, such as 1e-12.")
    p = len(parameters) or len(factor) - 1
    limit = precision(parameters) if tolerance is None else tolerance
    R = factor[:p, :p]
    scale, empty = _column_scales(np.linalg.norm(R, axis=0), parameters)
    # directions that have no effect without weights have none with them
    free_count = 0 if unweighted is None else p - unweighted.rank
    # directions without effect, then all others, orthonormal in these units
    turn = (
        np.eye(p)
        if unweighted is None
        else np.linalg.qr(unweighted.free_directions * scale[:, None], mode="complete")[0]
    )
    U, s, Vt = np.linalg.svd(np.where(empty, 0.0, R / scale) @ turn[:, free_count:])
    rank = int((s > (limit if unweighted is None else ARITHMETIC) * s[0]).sum()) if len(s) and s[0] > 0 else 0
    vectors = np.concatenate([turn[:, free_count:] @ Vt.T, turn[:, :free_count]], axis=1)
    vectors[empty, :rank] = 0.0  # a zero column has no share in any direction
    # the values of free directions keep their ratio, and stay below all others
    dropped_values = (
        np.zeros(0)
        if unweighted is None
        else unweighted.values[unweighted.rank :] / (unweighted.values[0] or 1.0) * s.max(initial=0.0)
    )
    values = np.concatenate([s, np.minimum(dropped_values, s.min(initial=np.inf))])
    return Rank(rank, scale, values, U, vectors, limit, unweighted)


def rank_of_information(information: Array, parameters: Sequence[Parameter] = ()) -> Rank:
    """Return the rank of an information matrix X' X (p, p), which has half of the digits of X."""
    p = len(information)
    scale, empty = _column_scales(np.sqrt(np.maximum(np.diag(information), 0.0)), parameters)
    full_rank = Rank(p, scale, np.ones(p), np.eye(p), np.eye(p), precision(parameters))
    return full_rank.with_information(np.where(empty | empty[:, None], 0.0, information))


def _column_scales(effect: Array, parameters: Sequence[Parameter]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the scale of each column (p), and whether the column is zero."""
    scale = effect.copy()
    # inertial parameters of one kind share the scale of their largest effect (see above)
    for kind in KINDS:
        alike = [k for k, x in enumerate(parameters) if x.role in kind]
        scale[alike] = effect[alike].max(initial=0.0)
    empty = (effect <= MAX_EMPTY_RATIO * effect.max(initial=0.0)) | (scale == 0)
    return np.where(empty & (scale == 0), 1.0, scale), empty


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
