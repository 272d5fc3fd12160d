"""The measured torque as an estimator sees it: sample by sample, or by Gauss's rule, a few points for many samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from dynident.log import Log

__all__ = ["POINTS", "Torques", "condensed"]

Array = NDArray[np.float64]
POINTS = 8  # of Gauss's rule, for the samples of one interval
KEPT, LONG = 8, 10_000  # rules that are kept for recordings to come, and samples of one that is too large for it
CLOSE = 0.03  # torques this close to a polynomial, in standard deviations of a sample, count as polynomial


@dataclass(frozen=True, eq=False)
class Torques:
    """Torques tau (K, n) at times t (K), each of ``weight`` (K, n) samples; ``scatter`` (n) is what they leave out.

    The sum over all samples of the squared distance from a smooth function f is that of weight (tau - f(t))^2, and the
    scatter.
    """

    t: Array
    tau: Array
    weight: Array
    scatter: Array

    @classmethod
    def of(cls, log: Log, time_offset: float = 0.0, used: NDArray[np.bool_] | None = None) -> Torques:
        """Return a log's samples one by one: those at which the positions, ``time_offset`` (s) late, show the motion.

        Samples that are not ``used`` (N, n) have weight zero.
        """
        t = log.t
        keep = (t >= t[0] - time_offset) & (t <= t[-1] - time_offset)
        weight = np.ones_like(log.tau) if used is None else used.astype(float)
        return cls(t[keep], log.tau[keep], weight[keep], np.zeros(log.tau.shape[1]))


def condensed(raw: Torques, interval: NDArray[np.intp], torque: Array, sigma_tau: Array) -> Torques:
    """Return torques with those of each interval replaced by a few points, where that is exact.

    ``interval`` (K) tells, in order, where each lies; ``torque`` (K, n) is about what the model will say, which has to
    be a polynomial of degree 7 there, but for a small part of ``sigma_tau`` (n), and so in the intervals beside. The
    points are the zeros of the polynomial of degree 8 that is orthogonal over the samples, with Gauss and Christoffel's
    weights: squares of polynomials of degree 7 are summed exactly (Golub and Welsch, 1969).
    """
    first, count = np.unique(interval, return_index=True, return_counts=True)[1:]
    chosen = (count > POINTS + 1) & np.logical_and.reduceat((raw.weight == 1).all(axis=1), first)
    if not chosen.any():
        return raw
    rough = _rule(raw.t, first, count, chosen).left(torque / sigma_tau)
    plain = np.ones(len(count), dtype=bool)
    np.logical_and.at(plain, np.repeat(np.flatnonzero(chosen), count[chosen]), (np.abs(rough) < CLOSE).all(axis=1))
    plain[1:-1] &= plain[2:] & plain[:-2]  # a reversal of the motion may still move
    chosen &= plain
    if not chosen.any():
        return raw
    rule = _rule(raw.t, first, count, chosen)
    t, tau, weight = rule.points(raw.tau)
    own = ~rule.member
    order = np.argsort(np.concatenate([raw.t[own], t]), kind="stable")
    return Torques(
        np.concatenate([raw.t[own], t])[order],
        np.concatenate([raw.tau[own], tau])[order],
        np.concatenate([raw.weight[own], np.repeat(weight[:, None], tau.shape[1], axis=1)])[order],
        (rule.left(raw.tau) ** 2).sum(axis=0),
    )


def _rule(t: Array, first: NDArray[np.intp], count: NDArray[np.intp], chosen: NDArray[np.bool_]) -> _Rule:
    """Return the rule of these samples, which is computed once for all recordings with these times."""
    if len(t) > LONG:
        return _Rule.over(t, first, count, chosen)
    return _kept(t.tobytes(), first.tobytes(), count.tobytes(), chosen.tobytes())


@lru_cache(maxsize=KEPT)
def _kept(t: bytes, first: bytes, count: bytes, chosen: bytes) -> _Rule:
    starts, sizes = np.frombuffer(first, dtype=np.intp), np.frombuffer(count, dtype=np.intp)
    return _Rule.over(np.frombuffer(t), starts, sizes, np.frombuffer(chosen, dtype=bool))


@dataclass(frozen=True, eq=False)
class _Rule:
    """Polynomials (POINTS, M), orthonormal over the M samples of the chosen intervals, which begin at ``start`` (I).

    ``diagonal``, ``beside`` (POINTS, I) are the coefficients of their recursion in x = (t - middle) / half.
    """

    member: NDArray[np.bool_]
    start: NDArray[np.intp]
    count: NDArray[np.intp]
    middle: Array
    half: Array
    polynomials: Array
    diagonal: Array
    beside: Array

    @classmethod
    def over(cls, t: Array, first: NDArray[np.intp], count: NDArray[np.intp], chosen: NDArray[np.bool_]) -> _Rule:
        """Return the rule for the ``chosen`` stretches of samples, which have these first samples and counts."""
        member, size = np.repeat(chosen, count), count[chosen]
        start = np.concatenate([[0], np.cumsum(size)[:-1]])
        low, high = t[first[chosen]], t[first[chosen] + size - 1]
        middle, half = (low + high) / 2, (high - low) / 2
        x = (t[member] - np.repeat(middle, size)) / np.repeat(half, size)
        rows = np.empty((POINTS, len(x)))
        diagonal, beside = np.empty((2, POINTS, len(size)))
        rows[0] = np.repeat(1 / np.sqrt(size), size)
        for k in range(POINTS):
            diagonal[k] = np.add.reduceat(x * rows[k] ** 2, start)
            following = (x - np.repeat(diagonal[k], size)) * rows[k]
            if k:
                following -= np.repeat(beside[k - 1], size) * rows[k - 1]
            beside[k] = np.sqrt(np.add.reduceat(following**2, start))
            if k + 1 < POINTS:
                rows[k + 1] = following / np.repeat(beside[k], size)
        return cls(member, start, size, middle, half, rows, diagonal, beside)

    def coefficients(self, x: Array) -> Array:
        """Return the coefficients (POINTS, I, n) of the polynomials nearest to x (N, n)."""
        return np.stack([np.add.reduceat(row[:, None] * x[self.member], self.start) for row in self.polynomials])

    def left(self, x: Array) -> Array:
        """Return what the polynomials leave (M, n) of x (N, n)."""
        fitted = np.repeat(self.coefficients(x), self.count, axis=1)
        return np.asarray(x[self.member] - np.einsum("km,kmj->mj", self.polynomials, fitted))

    @cached_property
    def _nodes(self) -> tuple[Array, Array, Array]:
        """Times (I POINTS), weights (I POINTS), and the polynomials there (I, POINTS, POINTS)."""
        along = np.arange(POINTS)
        jacobi = np.zeros((len(self.count), POINTS, POINTS))
        jacobi[:, along, along] = self.diagonal.T
        jacobi[:, along[1:], along[:-1]] = self.beside[:-1].T
        zeros, vectors = np.linalg.eigh(jacobi)
        weight = self.count[:, None] * vectors[:, 0] ** 2
        values = np.swapaxes(vectors * np.sign(vectors[:, :1]), 1, 2) / np.sqrt(weight)[:, :, None]
        return (self.middle[:, None] + self.half[:, None] * zeros).ravel(), weight.ravel(), values

    def points(self, x: Array) -> tuple[Array, Array, Array]:
        """Return times (I POINTS), nearest polynomials of x there (I POINTS, n), and weights (I POINTS)."""
        t, weight, values = self._nodes
        return t, (values @ np.swapaxes(self.coefficients(x), 0, 1)).reshape(-1, x.shape[1]), weight
