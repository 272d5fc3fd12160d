"""Trajectories: splines of degree 4 with dense knots after a step of the torque, where the motion is fast."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import as_strided, sliding_window_view
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpbtrs, dtbtrs

from dynident.motion.splines.quintic import local_basis
from dynident.runtime import ModelError, Noun
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Index = NDArray[np.intp]
JITTER = (0.0, 1e-13, 1e-10)  # added to the unit diagonal where rounding makes the factorisation fail


def places(first_rows: Index, d: int) -> list[slice | Index]:
    """Return where rows first_rows[i] + a of all i are, for a = 0 ... d - 1.

    ``first_rows`` (I) is sorted. Where it rises by one, slices are returned, which are faster than indices.
    """
    if len(first_rows) and first_rows[-1] - first_rows[0] == len(first_rows) - 1:
        return [slice(int(first_rows[0]) + a, int(first_rows[-1]) + a + 1) for a in range(d)]
    return [first_rows + a for a in range(d)]


def add_rows(total: Array, rows: Array, at: Sequence[slice | Index]) -> None:
    """Add the rows (I, d, ...) of blocks to ``total`` (m, ...), ``at`` their :func:`places`."""
    for a, place in enumerate(at):
        total[place] += rows[:, a]


def add_ahead(total: Array, blocks: Array, at: Sequence[slice | Index]) -> None:
    """Add symmetric blocks (I, d, n, d n) to ``total`` (m, n, d n), above the diagonal.

    Each unknown has its own block and those after it.
    """
    n = total.shape[1]
    for a, place in enumerate(at):
        total[place, :, : (len(at) - a) * n] += blocks[:, a, :, a * n :]


def band_of(total: Array) -> Array:
    """Return the lower band (d n, m n), as LAPACK stores it, of the sums (m, n, d n) of ``add_ahead``."""
    m, n, w = total.shape
    # a view with a longer stride shears the blocks of rows into the columns of the band, without a loop over them
    flat = np.concatenate([total.ravel(), np.zeros(w)])
    size = flat.itemsize
    band = as_strided(flat, (m, n, w), (n * w * size, (w + 1) * size, size)).copy()
    # the sheared rows of a block reach into the next one: those entries lie outside the band
    for j in range(1, n):
        band[:, j, w - j :] = 0.0
    return band.reshape(m * n, w).T


class Arrow(Noun):
    """The symmetric matrix [[N, B], [B', D]]: ``band`` (w, m) is the lower band of N, ``border`` B (m, b).

    Only N must be positive definite; ModelError where it is not.
    """

    band: Array
    border: Array

    @cached_property
    def _factor(self) -> tuple[Array, Array]:
        """The Cholesky factor of N scaled to a unit diagonal, and the scale (m)."""
        diagonal = self.band[0]
        if not (diagonal > 0).all() or not np.isfinite(self.band).all():
            raise ModelError("a part of the trajectory is not determined by the recording.")
        scale = 1.0 / np.sqrt(diagonal)
        w = len(self.band)
        # scale the rows and columns of the band to a unit diagonal
        scale_ahead = sliding_window_view(np.concatenate([scale, np.zeros(w - 1)]), w)  # (m, w)
        unit_band = (self.band.T * (scale_ahead * scale[:, None])).T
        for jitter in JITTER:
            unit_band[0] = 1.0 + jitter
            factor, failed = dpbtrf(unit_band, lower=1)
            if not failed:
                return factor, scale
        raise ModelError("the normal equations of the trajectory are not positive definite.")

    def solve_band(self, rhs: Array) -> Array:
        """Return N^-1 rhs for rhs (m, k)."""
        factor, scale = self._factor
        solution, _ = dpbtrs(factor, _scale_rows(rhs, scale), lower=1, overwrite_b=1)
        return np.asarray(solution * scale[:, None])

    @cached_property
    def half(self) -> Array:
        """L^-1 B (m, b), where L L' = N."""
        factor, scale = self._factor
        return np.asarray(dtbtrs(factor, _scale_rows(self.border, scale), uplo="L", overwrite_b=1)[0])

    def solve_transposed(self, half: Array) -> Array:
        """Return L'^-1 x for x (m, k); applied to ``half`` it gives N^-1 B."""
        factor, scale = self._factor
        return np.asarray(dtbtrs(factor, half, uplo="L", trans="T")[0] * scale[:, None])

    @property
    def lost_information(self) -> Array:
        """B' N^-1 B (b, b): the border's information that is lost to the unknown trajectory."""
        return np.asarray(self.half.T @ self.half)

    @cached_property
    def inverse(self) -> Array:
        """The band of N^-1, stored like N's: Takahashi's recursion, from the last column to the first."""
        factor, scale = self._factor
        w, m = factor.shape
        out = np.zeros((w, m))
        window = np.zeros((w, w))  # N^-1 at the unknowns i + 1 ... i + w
        # only the w last columns of the inverse are needed for the next one, so that the full inverse is never formed
        for i in range(m - 1, -1, -1):
            pivot, below = factor[0, i], factor[1:, i] / factor[0, i]
            column = -window[:-1, :-1] @ below
            window[1:, 1:] = window[:-1, :-1].copy()
            window[0, 0] = 1.0 / pivot**2 - below @ column
            window[0, 1:] = window[1:, 0] = column
            out[:, i] = window[:, 0]
        # undo the scaling to a unit diagonal
        for d in range(w):
            out[d, : m - d] *= scale[: m - d] * scale[d:]
        return out


def _scale_rows(rhs: Array, scale: Array) -> Array:
    """Return the rows of rhs (m, k) times the scale (m), column by column in memory, as LAPACK needs it."""
    return np.multiply(rhs, scale[:, None], order="F")


DEGREE = 4
BLOCK_ENTRIES = 25000  # entries of a joint's derivatives in about one block: few enough to stay in a processor's cache
JUMP_MULTIPLICITY = 3  # of a knot at which the acceleration may jump: DEGREE - JUMP = 1 continuous derivative


def graded_breaks(
    ends: tuple[float, float], steps: Sequence[float], fine: float, coarse: float, growth: float
) -> Array:
    """Return distinct breakpoints between two ``ends`` (s).

    The spacing is ``fine`` after each of the ``steps`` and grows by the factor ``growth`` from one to the next up to
    ``coarse``; the part before the first step is coarse.
    """
    start, stop = ends
    marks = sorted({start, *(s for s in steps if start <= s < stop), stop})
    parts = []
    for mark, next_mark in itertools.pairwise(marks):
        size = fine if mark in steps else coarse
        breaks, position = [0.0], 0.0
        while position < next_mark - mark:
            position += size
            breaks.append(position)
            size = min(size * growth, coarse)
        # squeezed, so that the last one ends the part
        parts.append(mark + np.array(breaks[:-1]) * (next_mark - mark) / breaks[-1])
    return np.concatenate([*parts, [stop]])


class TrajectoryBlock(Noun):
    """A block of a trajectory's ``intervals``, and all points in them, as slices.

    ``at`` are the :func:`places` of their five coefficients. ``runs`` are neighbouring intervals with the same
    number of points, which is above zero: intervals and points, both counted within the block.
    """

    intervals: slice
    points: slice
    at: list[slice | Index]
    runs: tuple[tuple[slice, slice], ...]

    def products(self, left_rows: Array, right_rows: Array, out: Array | None = None) -> Array:
        """Return the sums (intervals, a, b) of left' right over the rows of each interval.

        ``left_rows`` (B, ..., a) and ``right_rows`` (B, ..., b) are those of the block. ``out`` (intervals or more,
        a, b) may be overwritten by the sums.
        """
        a, b, count = left_rows.shape[-1], right_rows.shape[-1], self.intervals.stop - self.intervals.start
        out = np.empty((count, a, b)) if out is None else out[:count]
        # intervals without points are in no run: their products are zero
        if sum(intervals.stop - intervals.start for intervals, _ in self.runs) < count:
            out[:] = 0.0
        # neighbours with equally many points are multiplied in one call
        for intervals, points in self.runs:
            size = intervals.stop - intervals.start
            left_blocks, right_blocks = left_rows[points].reshape(size, -1, a), right_rows[points].reshape(size, -1, b)
            np.matmul(np.swapaxes(left_blocks, 1, 2), right_blocks, out=out[intervals])
        return out


def _interval_runs(edges: Index) -> tuple[tuple[slice, slice], ...]:
    """Return the runs of intervals that end at ``edges`` of the points."""
    count = np.diff(edges)
    ends = [0, *(np.flatnonzero(np.diff(count)) + 1).tolist(), len(count)]
    runs = ((slice(a, b), slice(int(edges[a]), int(edges[b]))) for a, b in itertools.pairwise(ends))
    return tuple((intervals, points) for intervals, points in runs if points.stop > points.start)


class SplineTrajectory(Noun):
    """The splines of degree 4 on ``breaks`` (I + 1) s, whose acceleration may jump at ``steps``."""

    breaks: Array
    steps: tuple[float, ...] = ()

    @cached_property
    def knots(self) -> Array:
        """All knots, repeated at the ends and at the steps."""
        times = np.where(np.isin(self.breaks, self.steps), JUMP_MULTIPLICITY, 1)
        times[[0, -1]] = DEGREE + 1
        return np.repeat(self.breaks, times)

    @property
    def size(self) -> int:
        """The number of coefficients of one joint."""
        return len(self.knots) - DEGREE - 1

    @cached_property
    def first_coefficient(self) -> Index:
        """The first (I) of the five coefficients that act on each interval."""
        return np.searchsorted(self.knots, self.breaks[:-1], side="right") - 1 - DEGREE

    def interval(self, t: Array) -> Index:
        """Return the interval (N) that each time lies in; a break belongs to the one that begins there."""
        return np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, len(self.breaks) - 2)

    def blocks(self, t: Array, n: int) -> Iterator[TrajectoryBlock]:
        """Yield blocks of whole intervals, with some hundreds or thousands of the sorted times (N) each.

        The more joints n there are, the fewer.
        """
        count, lo, size = len(self.first_coefficient), 0, max(BLOCK_ENTRIES // n**2, 1)
        edges = np.searchsorted(self.interval(t), np.arange(count + 1))
        while lo < count:
            hi = min(max(int(np.searchsorted(edges, edges[lo] + size, side="right")) - 1, lo + 1), count)
            points, at = slice(int(edges[lo]), int(edges[hi])), places(self.first_coefficient[lo:hi], DEGREE + 1)
            yield TrajectoryBlock(slice(lo, hi), points, at, _interval_runs(edges[lo : hi + 1] - edges[lo]))
            lo = hi

    def local(self, t: Array) -> Array:
        """Return values, first and second derivatives (3, N, 5) of the five splines that act on each time."""
        return local_basis(self.knots, DEGREE, self.first_coefficient[self.interval(t)] + DEGREE, t)


RIDGE = 1e-9  # of the products of the basis, where a coefficient acts on no time
CACHED_BASES, MAX_CACHED_TIMES = 16, 10_000  # bases kept for other recordings, and times of one that is too large


def basis(trajectory: SplineTrajectory, t: Array, *, from_rest: bool) -> Basis:
    """Return the splines of a trajectory at times t (N)."""
    if len(t) > MAX_CACHED_TIMES:
        return Basis(trajectory, t, from_rest)
    return _cached_basis(trajectory.breaks.tobytes(), trajectory.steps, t.tobytes(), from_rest)


@lru_cache(maxsize=CACHED_BASES)
def _cached_basis(breaks: bytes, steps: tuple[float, ...], t: bytes, from_rest: bool) -> Basis:
    return Basis(SplineTrajectory(np.frombuffer(breaks), steps), np.frombuffer(t), from_rest)


class Basis(Noun):
    """The m splines of a ``trajectory`` at times ``t`` (N); ``from_rest``, the first two coefficients are one."""

    trajectory: SplineTrajectory
    t: Array
    from_rest: bool

    @cached_property
    def interval(self) -> NDArray[np.intp]:
        """The interval (N) that each time lies in."""
        return self.trajectory.interval(self.t)

    @cached_property
    def local(self) -> Array:
        """Values, first and second derivatives (3, N, 5) of the splines that act at each time."""
        values = self.trajectory.local(self.t)
        if self.from_rest:
            # a start from rest has a zero derivative: the first coefficient equals the second, and acts through it
            begin = self.interval == 0
            values[:, begin, 1] += values[:, begin, 0]
            values[:, begin, 0] = 0.0
        return values

    @cached_property
    def values(self) -> csr_array:
        """The splines at the times (N, m)."""
        return self._sparse(1)

    @cached_property
    def transposed_values(self) -> csr_array:
        """The transpose of ``values`` (m, N), stored by rows."""
        return self.values.T.tocsr()

    @cached_property
    def _all_orders(self) -> csr_array:
        return self._sparse(3)

    def _sparse(self, orders: int) -> csr_array:
        """Return the first ``orders`` of values, first and second derivatives (orders N, m)."""
        columns = np.tile((self.trajectory.first_coefficient[self.interval][:, None] + np.arange(5)).ravel(), orders)
        V = self.local[:orders].ravel()
        from scipy.sparse import csr_array

        return csr_array((V, columns, np.arange(0, len(V) + 1, 5)), shape=(len(V) // 5, self.trajectory.size))

    def motion(self, C: Array) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (N, n) of coefficients C (m, n)."""
        q, dq, ddq = (self._all_orders @ C).reshape(3, -1, C.shape[1])
        return q, dq, ddq

    def by_interval(self, x: Array) -> Array:
        """Return the sums (I, ...) over each interval of a quantity given at the times (N, ...)."""
        start = np.flatnonzero(np.diff(self.interval, prepend=-1))
        out = np.zeros((len(self.trajectory.first_coefficient), *x.shape[1:]))
        out[self.interval[start]] = np.add.reduceat(x, start)
        return out

    def band(self, blocks: Array) -> Array:
        """Return the band (5, m) of one joint's coefficients from blocks (I, 5, 5) by interval."""
        total = np.zeros((self.trajectory.size, 1, 5))
        add_ahead(total, blocks[:, :, None], places(self.trajectory.first_coefficient, 5))
        return band_of(total)

    @cached_property
    def gram(self) -> Array:
        """Sum of products (I, 5, 5) of the splines over the times of each interval."""
        V = self.local[0]
        return self.by_interval(V[:, :, None] * V[:, None, :])

    @cached_property
    def gram_band(self) -> Array:
        """The band (5, m) of the products of the splines over all times."""
        return self.band(self.gram)

    @cached_property
    def products(self) -> csr_array:
        """The products of the splines over all times (m, m), sparse."""
        return self.transposed_values @ self.values

    @cached_property
    def normal_equations(self) -> Arrow:
        """The normal equations of a fit to values at the times."""
        band = self.gram_band.copy()
        # a small ridge keeps coefficients finite that act on no time
        band[0] += RIDGE * band[0].max()
        return Arrow(band, np.zeros((self.trajectory.size, 0)))

    @cached_property
    def acceleration_band(self) -> Array:
        """The band (5, m) of the squared acceleration, summed over as many times as there are in ``t``."""
        breaks = self.trajectory.breaks
        accelerations = basis(self.trajectory, (breaks[:-1] + breaks[1:]) / 2, from_rest=self.from_rest).local[2]
        share = np.diff(breaks) * len(self.t) / (breaks[-1] - breaks[0])
        return self.band(share[:, None, None] * accelerations[:, :, None] * accelerations[:, None, :])
