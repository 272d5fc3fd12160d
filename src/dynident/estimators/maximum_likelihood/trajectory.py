"""Trajectories: splines of degree 4 whose knots are dense after a step of the torque, where the motion is fast."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.estimators.maximum_likelihood.arrow import places
from dynident.splines.bspline import local_basis

__all__ = ["DEGREE", "Trajectory", "TrajectoryBlock", "graded"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]
DEGREE = 4
BLOCK = 25000  # entries of a joint's derivatives in about one block: few enough to stay in a processor's cache
JUMP = 3  # multiplicity of a knot at which the acceleration may jump: DEGREE - JUMP = 1 continuous derivative


def graded(start: float, stop: float, steps: Sequence[float], fine: float, coarse: float, growth: float) -> Array:
    """Return distinct breakpoints from start to stop (s).

    The spacing is ``fine`` after each of the ``steps`` and grows by the factor ``growth`` from one to the next up to
    ``coarse``; the part before the first step is coarse.
    """
    marks = sorted({start, *(s for s in steps if start <= s < stop), stop})
    parts = []
    for left, right in itertools.pairwise(marks):
        size = fine if left in steps else coarse
        found, at = [0.0], 0.0
        while at < right - left:
            at += size
            found.append(at)
            size = min(size * growth, coarse)
        # squeezed, so that the last one ends the part
        parts.append(left + np.array(found[:-1]) * (right - left) / found[-1])
    return np.concatenate([*parts, [stop]])


@dataclass(frozen=True, eq=False)
class TrajectoryBlock:
    """Some of a trajectory's ``intervals``, and all points in them, as slices.

    ``at`` are the :func:`places` of their five coefficients. ``runs`` are neighbouring intervals with the same number
    of points, which is above zero: intervals and points, both counted within the block.
    """

    intervals: slice
    points: slice
    at: list[slice | Index]
    runs: tuple[tuple[slice, slice], ...]

    def products(self, left: Array, right: Array, out: Array | None = None) -> Array:
        """Return the sums (intervals, a, b) of left' right over the rows (B, ..., a), (B, ..., b) of each interval.

        ``out`` (intervals or more, a, b) may be overwritten by them.
        """
        a, b, count = left.shape[-1], right.shape[-1], self.intervals.stop - self.intervals.start
        out = np.empty((count, a, b)) if out is None else out[:count]
        if sum(there.stop - there.start for there, _ in self.runs) < count:
            out[:] = 0.0
        for there, at in self.runs:
            size = there.stop - there.start
            one, other = left[at].reshape(size, -1, a), right[at].reshape(size, -1, b)
            np.matmul(np.swapaxes(one, 1, 2), other, out=out[there])
        return out


def _runs(edges: Index) -> tuple[tuple[slice, slice], ...]:
    """Return the runs of intervals that end at ``edges`` of the points."""
    count = np.diff(edges)
    ends = [0, *(np.flatnonzero(np.diff(count)) + 1).tolist(), len(count)]
    found = ((slice(a, b), slice(int(edges[a]), int(edges[b]))) for a, b in itertools.pairwise(ends))
    return tuple((there, at) for there, at in found if at.stop > at.start)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The splines of degree 4 on ``breaks`` (I + 1) s, with jumps of the acceleration allowed at ``steps``."""

    breaks: Array
    steps: tuple[float, ...] = ()

    __repr__ = brief

    @cached_property
    def knots(self) -> Array:
        """All knots, repeated at the ends and at the steps."""
        inside = self.breaks[1:-1]
        times = np.where(np.isin(inside, self.steps), JUMP, 1)
        ends = (np.full(DEGREE + 1, self.breaks[0]), np.full(DEGREE + 1, self.breaks[-1]))
        return np.concatenate([ends[0], np.repeat(inside, times), ends[1]])

    @property
    def size(self) -> int:
        """The number of coefficients of one joint."""
        return len(self.knots) - DEGREE - 1

    @cached_property
    def first(self) -> Index:
        """First (I) of the five coefficients that act on each interval."""
        return np.searchsorted(self.knots, self.breaks[:-1], side="right") - 1 - DEGREE

    def interval(self, t: Array) -> Index:
        """Return the interval (N) that each time lies in; a break belongs to the one that begins there."""
        return np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, len(self.breaks) - 2)

    def blocks(self, t: Array, n: int) -> Iterator[TrajectoryBlock]:
        """Yield the blocks of whole intervals, each with some hundred or thousand of the times (N), which are sorted.

        The more joints n there are, the fewer.
        """
        count, lo, size = len(self.first), 0, max(BLOCK // n**2, 1)
        edges = np.searchsorted(self.interval(t), np.arange(count + 1))
        while lo < count:
            hi = min(max(int(np.searchsorted(edges, edges[lo] + size, side="right")) - 1, lo + 1), count)
            points, at = slice(int(edges[lo]), int(edges[hi])), places(self.first[lo:hi], DEGREE + 1)
            yield TrajectoryBlock(slice(lo, hi), points, at, _runs(edges[lo : hi + 1] - edges[lo]))
            lo = hi

    def local(self, t: Array) -> Array:
        """Return values, first and second derivatives (3, N, 5) of the five splines that act on each time."""
        return local_basis(self.knots, DEGREE, self.first[self.interval(t)] + DEGREE, t)
