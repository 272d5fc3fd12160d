"""The banded linear system of the smoothing spline, eq. (32), in scaled units.

Times are in units of the mean step and delta in units of its root mean square, so that nothing depends on the units
of the data. With u of eq. (32), c = p u: ``(Q' D^2 Q + p N) u = Q' y``, where Q' is the transpose of Q.

Here LAPACK solves it; ``compiled.py`` does the same with the kernel where there is one.
"""

from __future__ import annotations

from dataclasses import field
from functools import cached_property
from math import nan
from typing import NamedTuple

import numpy as np
from scipy.linalg import blas, lapack

from dynident.runtime import Noun
from dynident.runtime.arrays import Array

EPS = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)


class IllConditionedError(ArithmeticError):
    """The system is too ill-conditioned for double precision: relative error eps * bandwidth^4 near one."""


def second_difference(y: Array, step: Array) -> Array:
    """Return Q' y: differences of the slopes between neighbours; ``y`` (N), ``step`` (N - 1) gives (N - 2)."""
    slope = np.diff(y)
    slope /= step
    return np.diff(slope)


def _second_difference_adjoint(u: Array, step: Array) -> Array:
    """Return Q u, shape (N), the adjoint of ``second_difference``."""
    slope = np.empty(len(step))
    slope[0], slope[-1] = u[0], -u[-1]
    np.subtract(u[1:], u[:-1], out=slope[1:-1])
    slope /= step
    out = np.empty(len(step) + 1)
    out[0], out[-1] = slope[0], -slope[-1]
    np.subtract(slope[1:], slope[:-1], out=out[1:-1])
    return out


class Solution(NamedTuple):
    """u of eq. (32) for one p, and ``rss`` = |D Q u|^2; ``u`` is None where only figures were asked for.

    ``residual`` is the norm of Q' y - (Q' D^2 Q + p N) u relative to that of Q' y, and ``accuracy`` the relative error
    of u estimated from the last refinement step (both nan without refinement); ``slope`` is d log(rss) / d log(p) and
    ``energy`` u' N u. ``rise`` and ``bend`` are the first and second derivative of ``log_det``, the logarithm of the
    determinant, by log p, where they were requested; 2 + ``rise`` are the effective degrees of freedom. ``norm`` is
    that of u, with refinement.
    """

    p: float
    u: Array | None
    rss: float
    residual: float = nan
    accuracy: float = nan
    slope: float = nan
    energy: float = nan
    log_det: float = nan
    rise: float = nan
    bend: float = nan
    norm: float = nan


class Axis(Noun):
    """The times ``x`` (N) less their mean, with weights ``w``; ``wx`` their product, ``total`` the sum of the weights
    and ``square`` that of w x^2."""

    x: Array
    w: Array
    wx: Array
    total: float
    square: float

    @classmethod
    def of(cls, step: Array, w: Array) -> Axis:
        """Return the axis of times that are ``step`` (N - 1) apart."""
        x, total = np.zeros(len(w)), float(w.sum())
        # centred times keep the fit of a straight line well conditioned
        np.cumsum(step, out=x[1:])
        x -= float(w @ x) / total
        wx = w * x
        return cls(x, w, wx, total, float(wx @ x))


class Grid(Noun):
    """Times in units of the mean step: ``step`` (N - 1), all that the columns of data have in common."""

    step: Array

    parts: dict[tuple[int, int], Grid] = field(default_factory=dict)

    def part(self, rows: slice) -> Grid:
        """Return the grid of the samples in ``rows``; the same object for the same samples."""
        return self.parts.setdefault((rows.start, rows.stop), Grid(self.step[rows][:-1]))

    @cached_property
    def reciprocal(self) -> Array:
        """1 / step (N - 1)."""
        return np.asarray(1.0 / self.step)

    @cached_property
    def addresses(self) -> tuple[int, int]:
        """Where ``step`` and ``reciprocal`` are in memory."""
        return self.step.ctypes.data, self.reciprocal.ctypes.data

    @cached_property
    def mass(self) -> tuple[Array, Array]:
        """The diagonal (N - 2) and off-diagonal (N - 3) of the tridiagonal N of eq. (28)."""
        return (2.0 / 3.0) * (self.step[:-1] + self.step[1:]), self.step[1:-1] / 3.0

    @cached_property
    def axis(self) -> Axis:
        """The times, to fit a straight line to samples of equal weight."""
        return Axis.of(self.step, np.ones(len(self.step) + 1))

    @cached_property
    def gram(self) -> Array:
        """The lower bands of Q' Q, as ``System.gram`` has them."""
        # a row of Q' is (r_i, -(r_i + r_i+1), r_i+1), so that Q' Q has two bands beside the diagonal
        r, bands = self.reciprocal, _empty_bands(len(self.step) - 1)
        middle, square = r[:-1] + r[1:], r * r
        bands[0] = middle * middle + square[:-1] + square[1:]
        bands[1, :-1] = -r[1:-1] * (middle[:-1] + middle[1:])
        bands[2, :-2] = r[1:-2] * r[2:-1]
        return bands


def _empty_bands(size: int) -> Array:
    """Return three bands to fill, in the order LAPACK wants, zero where they reach beyond the matrix."""
    out = np.empty((3, size), order="F")
    out[1, -1:] = out[2, -2:] = 0.0
    return out


class System:
    """The matrices of eq. (32) for one time grid and one set of weights.

    ``variance`` is the diagonal of D^2 (N), mean one, or None where all samples weigh the same. Reference: Reinsch
    (1967), eqs. (27)-(32) of the article.
    """

    def __init__(self, grid: Grid, variance: Array | None = None) -> None:
        self.grid = grid
        self.step = grid.step
        self.variance = variance
        self.size = len(grid.step) - 1

    def part(self, rows: slice) -> System:
        """Return the system of the samples in ``rows``."""
        return System(self.grid.part(rows), None if self.variance is None else self.variance[rows])

    @cached_property
    def axis(self) -> Axis:
        """The times and weights of the samples, to fit a straight line."""
        return self.grid.axis if self.variance is None else Axis.of(self.step, 1.0 / self.variance)

    @cached_property
    def gram(self) -> Array:
        """The lower bands of Q' D^2 Q, shape (3, N - 2)."""
        if (d := self.variance) is None:
            return self.grid.gram
        r, bands = self.grid.reciprocal, _empty_bands(self.size)
        middle = r[:-1] + r[1:]
        bands[0] = d[:-2] * r[:-1] ** 2 + d[1:-1] * middle**2 + d[2:] * r[1:] ** 2
        bands[1, :-1] = -r[1:-1] * (middle[:-1] * d[1:-2] + middle[1:] * d[2:-1])
        bands[2, :-2] = r[1:-2] * r[2:-1] * d[2:-2]
        return bands

    def mass(self, u: Array) -> Array:
        """Return N u, with the tridiagonal N of eq. (28)."""
        diagonal, off = self.grid.mass
        out = diagonal * u
        if self.size > 1:
            out[:-1] += off * u[1:]
            out[1:] += off * u[:-1]
        return out

    def factor(self, p: float) -> Array:
        """Return the banded Cholesky factor of Q' D^2 Q + p N; IllConditionedError where it breaks down."""
        # LAPACK factorises in place, and the bands of Q' D^2 Q are cached
        bands = self.gram.copy(order="F")
        diagonal, off = self.grid.mass
        bands[0] += p * diagonal
        if self.size > 1:
            bands[1, :-1] += p * off
        factor, info = lapack.dpbtrf(bands, lower=1, overwrite_ab=1)
        if info != 0:
            raise IllConditionedError("the Cholesky factorisation broke down")
        return factor  # type: ignore[no-any-return]

    def removed_signal(self, u: Array) -> Array:
        """Return D^2 Q u = y - g, shape (N)."""
        v = _second_difference_adjoint(u, self.step)
        if self.variance is not None:
            v *= self.variance
        return v

    def weighted_rss(self, v: Array) -> float:
        """Return |D^-1 v|^2."""
        return float(v @ v if self.variance is None else v @ (v / self.variance))

    def solve(self, p: float, z: Array, *, refine: bool = True, trace: bool = False) -> Solution:
        """Solve eq. (32) for the right-hand side z = Q' y.

        With ``refine``, iterative refinement with the residual in factored form, Q' (D^2 Q u), takes the relative
        error of u from eps * m^4 (m the bandwidth in samples) to a few eps. Without, figures alone are returned, with
        ``trace`` those of the determinant, too.
        """
        factor = self.factor(p)
        u = lapack.dpbtrs(factor, z, lower=1)[0]
        v = self.removed_signal(u)
        if refine:
            # figures alone need no refinement: p is searched with them, and only its last step is refined
            u, v, residual, accuracy = self._refine(p, factor, z, u, v)
            return Solution(p, u, self.weighted_rss(v), residual, accuracy, norm=float(np.sqrt(u @ u)))
        rss, mass_u = self.weighted_rss(v), self.mass(u)
        energy = float(u @ mass_u)
        # d log(rss) / d log(p) = -2 p (u' N u - p w' w) / rss with R' w = N u (step 3 of the algorithm)
        w = lapack.dtbtrs(factor, mass_u[:, None], uplo="L")[0]
        slope = -2.0 * p * (energy - p * float(np.vdot(w, w))) / max(rss, TINY)
        log_det_terms = _determinant(p, factor, self.grid) if trace else (np.nan, np.nan, np.nan)
        return Solution(p, None, rss, np.nan, np.nan, slope, energy, *log_det_terms)

    def _refine(self, p: float, factor: Array, z: Array, u: Array, v: Array) -> tuple[Array, Array, float, float]:
        # corrections shrink by a constant factor: stop where the next is below eps, or where rounding ends the decrease
        last_change, expected_error = 1.0, np.inf  # of the last correction (relative), and after it
        while True:
            residual = z - second_difference(v, self.step)
            residual -= p * self.mass(u)
            size = np.sqrt(float(residual @ residual) / max(float(z @ z), TINY))
            if expected_error <= EPS:
                return u, v, size, EPS
            correction = lapack.dpbtrs(factor, residual, lower=1)[0]
            change = np.sqrt(float(correction @ correction) / max(float(u @ u), TINY))
            if change >= 0.5 * last_change:  # no further improvement at this precision
                if not change < 1e-8:
                    raise IllConditionedError(f"iterative refinement stops at a relative correction of {change:.1e}")
                return u, v, size, change
            u = u + correction
            v = self.removed_signal(u)
            last_change, expected_error = change, change * change / last_change

    def interpolate(self, z: Array) -> Array:
        """Solve N c = Q' y, eq. (22): the natural interpolating spline."""
        diagonal, off = self.grid.mass
        if self.size == 1:
            return z / diagonal
        return lapack.dptsv(diagonal, off, z)[2]  # type: ignore[no-any-return]


def _determinant(p: float, factor: Array, grid: Grid) -> tuple[float, float, float]:
    """Return log det (Q' D^2 Q + p N) and its first and second derivative by log p, exactly.

    The recurrence of the factorisation L diag(d) L', differentiated, is linear in the derivatives of d_i and of e_i,
    the entry beside it: a triangular system of bandwidth 4 for e_0, d_0, e_1, d_1, ..., once for each derivative.
    """
    # from the Cholesky factor to L diag(d) L'
    root = np.ascontiguousarray(factor[0])
    d, l1, l2 = root * root, factor[1] / root, factor[2] / root
    # d_(i+1)' = p N_(i+1,i+1) - 2 l1_i e_i' + l1_i^2 d_i' + l2_(i-1)^2 d_(i-1)'
    # e_(i+1)' = p N_(i+1,i+2) - l2_i (e_i' - l1_i d_i')
    rows = np.zeros((len(root), 2, 5))
    rows[:, :, 0] = 1.0
    of_e, of_d = rows[:, 0], rows[:, 1]
    of_e[:, 2], of_e[:, 3] = l2, 2.0 * l1
    of_d[:, 1], of_d[:, 2], of_d[:, 4] = -l1 * l2, -l1 * l1, -l2 * l2
    matrix = rows.reshape(-1, 5).T
    diagonal, off = grid.mass
    right = np.zeros(2 * len(root))
    np.multiply(diagonal, p, out=right[1::2])
    np.multiply(off, p, out=right[0:-2:2])
    first_derivatives = blas.dtbsv(4, matrix, right, lower=1, diag=1)
    rate = first_derivatives[1::2] / d
    tilt = first_derivatives[0::2] / d - l1 * rate  # of l1; that of l2 is -fall
    fall = l2 * rate
    # second derivatives obey the same recurrence, with products of first derivatives on the right-hand side
    twice = 2.0 * d * tilt
    right[3::2] -= (twice * tilt)[:-1]
    right[2::2] += (twice * fall)[:-1]
    right[5::2] -= (2.0 * d * fall * fall)[:-2]
    second_derivatives = blas.dtbsv(4, matrix, right, lower=1, diag=1)
    bend = float((second_derivatives[1::2] / d).sum()) - float(rate @ rate)
    return 2.0 * float(np.log(root).sum()), float(rate.sum()), bend
