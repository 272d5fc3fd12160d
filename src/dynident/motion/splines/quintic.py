"""The banded linear system of the quintic smoothing spline: a penalty on the third derivative.

g minimises sum((g - y)^2) + lam * integral(g'''^2). Its third derivative is a sum of quadratic B-splines over three
steps each, with coefficients d = p u, p = 1 / (2 lam). With Q', the differences of the divided differences of order 2,
and N, half the Gram matrix of these B-splines, ``(Q' Q + p N) u = Q' y`` and ``y - g = Q u``, as for the cubic spline
(``banded.py``). Schoenberg (1964).

Times are in units of the mean step. The condition number of this matrix is the bandwidth in samples to the power 6.
Solved is therefore the augmented system ``g + Q u = y, Q' g = p N u``, whose condition is the square root of that
(Bjorck, 1996, Numerical methods for least squares problems, sec. 2.5.3).
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from dynident.motion.splines.banded import EPS, TINY, IllConditionedError
from dynident.runtime.arrays import Array

Index = NDArray[np.intp]


def local_basis(knots: Array, degree: int, m: Index, t: Array) -> Array:
    """Return values, first and second derivatives (3, N, degree + 1) of the B-splines that act on times t (N).

    ``m`` (N) is the interval of each time, knots[m] <= t <= knots[m + 1]; the splines m - degree ... m act there.
    ``degree`` is at least 2. De Boor (1978), "A practical guide to splines", chapter X.
    """
    values = [np.ones((len(t), 1))]
    for k in range(1, degree + 1):  # each from the values of one degree less
        values.append(np.zeros((len(t), k + 1)))
        for a in range(k):
            left, right = knots[m - k + 1 + a], knots[m + 1 + a]
            share = values[k - 1][:, a] / (right - left)
            values[k][:, a] += (right - t) * share
            values[k][:, a + 1] += (t - left) * share
    # a derivative needs the values of one degree less, the second derivative those of two degrees less
    slope = _differentiate(values[degree - 1], knots, degree, m)
    bend = _differentiate(_differentiate(values[degree - 2], knots, degree - 1, m), knots, degree, m)
    return np.stack([values[degree], slope, bend])


def _differentiate(lower: Array, knots: Array, degree: int, m: Index) -> Array:
    """Return the derivatives (N, degree + 1) of splines from their coefficients' basis ``lower`` of one degree less."""
    out = np.zeros((len(lower), degree + 1))
    for a in range(degree):
        share = degree * lower[:, a] / (knots[m + 1 + a] - knots[m - degree + 1 + a])
        out[:, a] -= share
        out[:, a + 1] += share
    return out


MAX_ROUNDING_CORRECTION = 1e-6  # largest relative correction of u that is left to rounding
HALF_BANDWIDTH = 4  # of the augmented matrix, on either side
BERNSTEIN_GRAM = np.array([[6.0, 3.0, 1.0], [3.0, 4.0, 3.0], [1.0, 3.0, 6.0]]) / 30.0  # Gram matrix of quadratic ones


class QuinticSolution(NamedTuple):
    """The spline of one p: g (N), u (N - 3), ``penalised_rss`` and ``log_det``.

    ``penalised_rss`` is y' Q u = |y - g|^2 + p u' N u, ``log_det`` is log det (Q' Q + p N).
    """

    p: float
    g: Array
    u: Array
    penalised_rss: float
    log_det: float


class QuinticSystem:
    """The matrices of a quintic smoothing spline for ``step`` (N - 1), N >= 4, in units of their mean."""

    def __init__(self, step: Array) -> None:
        self.step = step
        self.size = len(step) - 2

    @cached_property
    def rows(self) -> Array:
        """The rows (N - 3, 4) of Q'."""
        slope_weights, bend_weights = 1.0 / self.step, 1.0 / (self.step[:-1] + self.step[1:])
        # a divided difference of order 2 is a difference of slopes over two steps; Q' takes differences of these
        a, b, c = slope_weights[:-2], slope_weights[1:-1], slope_weights[2:]
        s, t = bend_weights[:-1], bend_weights[1:]
        return np.stack([-a * s, (a + b) * s + b * t, -b * s - (b + c) * t, c * t], axis=1)

    def differences(self, y: Array) -> Array:
        """Return Q' y (N - 3)."""
        slope = np.diff(y) / self.step
        return np.diff(np.diff(slope) / (self.step[:-1] + self.step[1:]))

    def spread(self, u: Array) -> Array:
        """Return Q u (N), the adjoint of ``differences``."""
        bend = -np.diff(u, prepend=0.0, append=0.0) / (self.step[:-1] + self.step[1:])
        slope = -np.diff(bend, prepend=0.0, append=0.0) / self.step
        return -np.diff(slope, prepend=0.0, append=0.0)

    @cached_property
    def shares(self) -> tuple[Array, Array]:
        """The shares (N) of the B-splines over the steps before and after in the third derivative at a sample."""
        h = np.concatenate(([1.0], self.step, [1.0]))
        return h[1:] / (h[1:] + h[:-1]), h[:-1] / (h[1:] + h[:-1])

    @cached_property
    def mass(self) -> Array:
        """The lower bands (3, N - 3) of N.

        Over a step, in Bernstein polynomials, its own B-spline is (after, 1, before), that of the step before
        (before, 0, 0) at its start, that of the step after (0, 0, after) at its end.
        """
        before, after = self.shares
        current = np.stack([after[:-1], np.ones(len(self.step)), before[1:]])
        previous, following = np.zeros_like(current), np.zeros_like(current)
        previous[0], following[2] = before[:-1], after[1:]

        def product(a: Array, b: Array) -> Array:
            return np.asarray(0.5 * self.step * np.einsum("ik,ij,jk->k", a, BERNSTEIN_GRAM, b))

        # inner products of neighbouring B-splines, step by step; no two more than two steps apart overlap
        out, n = np.zeros((3, self.size)), self.size
        out[0] = product(current, current)[1:-1] + product(previous, previous)[2:] + product(following, following)[:-2]
        out[1, : n - 1] = product(current, following)[1:-2] + product(previous, current)[2:-1]
        out[2, : max(n - 2, 0)] = product(previous, following)[2:-2]
        return out

    def mass_times(self, u: Array) -> Array:
        """Return N u."""
        out = np.asarray(self.mass[0] * u)
        for k in (1, 2):
            out[:-k] += self.mass[k, :-k] * u[k:]
            out[k:] += self.mass[k, :-k] * u[:-k]
        return out

    def solve(self, p: float, y: Array) -> QuinticSolution:
        """Solve for the data y (N), refined; raises IllConditionedError."""
        factor = _AugmentedSystem(self, p)
        g, u = factor.solve(y, np.zeros(self.size))
        last_change, expected_error = 1.0, np.inf
        # iterative refinement with the residuals of both equations of the augmented system
        while expected_error > EPS:
            dg, du = factor.solve(y - g - self.spread(u), p * self.mass_times(u) - self.differences(g))
            change = float(np.sqrt(du @ du / max(float(u @ u), TINY)))
            if not change < 0.5 * last_change:
                if not change < MAX_ROUNDING_CORRECTION:
                    raise IllConditionedError(f"iterative refinement stops at a relative correction of {change:.1e}")
                break
            g, u = g + dg, u + du
            last_change, expected_error = change, change * change / last_change
        removed = self.spread(u)
        return QuinticSolution(p, g, u, float(removed @ removed) + p * float(u @ self.mass_times(u)), factor.log_det)

    def derivatives(self, g: Array, d: Array) -> tuple[Array, Array]:
        """Return the first and second derivative (N) of the spline with values g (N) and coefficients d (N - 3).

        Both follow from the values beside a sample, less what the third derivative, known from d, adds to them.
        """
        h, middle = self.step, np.concatenate(([0.0], d, [0.0]))
        before, after = self.shares
        third = before * np.append(0.0, middle) + after * np.append(middle, 0.0)
        a, b = third[:-1], third[1:]
        # integrals of the quadratic third derivative over a step, with its Bernstein coefficients
        ahead = h * h * (a / 10 + middle / 20 + b / 60)  # the share of the slope of a step, seen from its start
        back = h * h * (b / 10 + middle / 20 + a / 60)
        slope, bend, gradient = np.diff(g) / h, np.empty_like(g), np.empty_like(g)
        bend[1:-1] = 2.0 * (np.diff(slope) - ahead[1:] + back[:-1]) / (h[1:] + h[:-1])
        bend[0] = bend[1] - h[0] * (a[0] + middle[0] + b[0]) / 3.0
        bend[-1] = bend[-2] + h[-1] * (a[-1] + middle[-1] + b[-1]) / 3.0
        gradient[:-1] = slope - 0.5 * h * bend[:-1] - ahead
        gradient[-1] = slope[-1] + 0.5 * h[-1] * bend[-1] - back[-1]
        return gradient, bend


class _AugmentedSystem:
    """The augmented system, by Gaussian elimination with pivoting; g and u alternate, so that it is banded."""

    def __init__(self, system: QuinticSystem, p: float) -> None:
        n, m = len(system.step) + 1, system.size
        # u in units of 1 / sqrt(p) makes the matrix symmetric, with blocks of like size
        self._scale = scale = float(np.sqrt(p))
        bands = np.zeros((3 * HALF_BANDWIDTH + 1, 2 * n - 1), order="F")
        middle = 2 * HALF_BANDWIDTH
        bands[middle, 0::2] = scale
        bands[middle, [1, -2]] = 1.0  # places that no u takes
        for k in range(min(3, m)):  # u_i is at 2 i + 3, sample i + j at 2 (i + j)
            entries = -scale * system.mass[k, : m - k]
            bands[middle + 2 * k, 3 : 3 + 2 * (m - k) : 2] = entries
            bands[middle - 2 * k, 3 + 2 * k : 3 + 2 * m : 2] = entries
        for j, entries in enumerate(system.rows.T):
            bands[middle + 3 - 2 * j, 2 * j : 2 * (j + m) : 2] = entries
            bands[middle - 3 + 2 * j, 3 : 3 + 2 * m : 2] = entries
        self._factor, self._pivots, info = lapack.dgbtrf(bands, HALF_BANDWIDTH, HALF_BANDWIDTH, overwrite_ab=1)
        if info != 0:
            raise IllConditionedError("the augmented system is singular")
        # the determinant of the augmented matrix is that of Q' Q + p N times a power of the scale
        self.log_det = float(np.log(np.abs(self._factor[middle])).sum()) - (n - m) * float(np.log(scale))

    def solve(self, data_side: Array, penalty_side: Array) -> tuple[Array, Array]:
        """Return g and u with g + Q u = ``data_side`` and Q' g - p N u = ``penalty_side``."""
        right = np.zeros(2 * len(data_side) - 1)
        right[0::2], right[3:-3:2] = self._scale * data_side, penalty_side
        solution = lapack.dgbtrs(self._factor, HALF_BANDWIDTH, HALF_BANDWIDTH, right, self._pivots, overwrite_b=1)[0]
        return np.asarray(solution[0::2]), np.asarray(solution[3:-3:2] / self._scale)
