"""The splines of a trajectory at given times, which are computed once for all recordings with these times."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from dynident.errors import brief
from dynident.estimators.maximum_likelihood.arrow import Arrow, add_ahead, band_of, places
from dynident.estimators.maximum_likelihood.trajectory import Trajectory

__all__ = ["Basis", "basis"]

Array = NDArray[np.float64]
RIDGE = 1e-9  # of the products of the basis, where a coefficient acts on no time
KEPT, LONG = 16, 10_000  # bases that are kept for recordings to come, and times of one that is too large for it


def basis(trajectory: Trajectory, t: Array, *, rest: bool) -> Basis:
    """Return the splines of a trajectory at times t (N)."""
    if len(t) > LONG:
        return Basis(trajectory, t, rest)
    return _kept(trajectory.breaks.tobytes(), trajectory.steps, t.tobytes(), rest)


@lru_cache(maxsize=KEPT)
def _kept(breaks: bytes, steps: tuple[float, ...], t: bytes, rest: bool) -> Basis:
    return Basis(Trajectory(np.frombuffer(breaks), steps), np.frombuffer(t), rest)


@dataclass(frozen=True, eq=False)
class Basis:
    """The m splines of a ``trajectory`` at times ``t`` (N); at ``rest`` the first two coefficients are one."""

    trajectory: Trajectory
    t: Array
    rest: bool

    __repr__ = brief

    @cached_property
    def interval(self) -> NDArray[np.intp]:
        """The interval (N) that each time lies in."""
        return self.trajectory.interval(self.t)

    @cached_property
    def local(self) -> Array:
        """Values, first and second derivatives (3, N, 5) of the splines that act on each time."""
        found = self.trajectory.local(self.t)
        if self.rest:
            begin = self.interval == 0
            found[:, begin, 1] += found[:, begin, 0]
            found[:, begin, 0] = 0.0
        return found

    @cached_property
    def values(self) -> csr_array:
        """The splines at the times (N, m)."""
        return self._sparse(1)

    @cached_property
    def transposed(self) -> csr_array:
        """The same (m, N), by rows."""
        return self.values.T.tocsr()

    @cached_property
    def _all(self) -> csr_array:
        return self._sparse(3)

    def _sparse(self, orders: int) -> csr_array:
        """Return the first ``orders`` of values, first and second derivatives (orders N, m)."""
        columns = np.tile((self.trajectory.first[self.interval][:, None] + np.arange(5)).ravel(), orders)
        V = self.local[:orders].ravel()
        return csr_array((V, columns, np.arange(0, len(V) + 1, 5)), shape=(len(V) // 5, self.trajectory.size))

    def motion(self, C: Array) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (N, n) of coefficients C (m, n)."""
        q, dq, ddq = (self._all @ C).reshape(3, -1, C.shape[1])
        return q, dq, ddq

    def by_interval(self, x: Array) -> Array:
        """Return the sums (I, ...) over each interval of what is given by time (N, ...)."""
        start = np.flatnonzero(np.diff(self.interval, prepend=-1))
        out = np.zeros((len(self.trajectory.first), *x.shape[1:]))
        out[self.interval[start]] = np.add.reduceat(x, start)
        return out

    def band(self, blocks: Array) -> Array:
        """Return the band (5, m) of one joint's coefficients from blocks (I, 5, 5) by interval."""
        total = np.zeros((self.trajectory.size, 1, 5))
        add_ahead(total, blocks[:, :, None], places(self.trajectory.first, 5))
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
        """The same (m, m), sparse."""
        return self.transposed @ self.values

    @cached_property
    def normal(self) -> Arrow:
        """The normal equations of a fit to values at the times."""
        band = self.gram_band.copy()
        band[0] += RIDGE * band[0].max()
        return Arrow(band, np.zeros((self.trajectory.size, 0)))

    @cached_property
    def bends(self) -> Array:
        """The band (5, m) of the squared acceleration, summed over as many times as there are."""
        breaks = self.trajectory.breaks
        bend = basis(self.trajectory, (breaks[:-1] + breaks[1:]) / 2, rest=self.rest).local[2]
        share = np.diff(breaks) * len(self.t) / (breaks[-1] - breaks[0])
        return self.band(share[:, None, None] * bend[:, :, None] * bend[:, None, :])
