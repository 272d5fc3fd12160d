"""The banded linear system of the smoothing spline, eq. (32), in scaled units.

Times are in units of the mean step and delta in units of its root mean square, so that nothing depends on the units
of the data. With u of eq. (32), c = p u: ``(Q' D^2 Q + p N) u = Q' y``, where Q' is the transpose of Q.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

__all__ = ["IllConditionedError", "Solution", "System", "second_difference"]

Array = NDArray[np.float64]
EPS = float(np.finfo(np.float64).eps)


class IllConditionedError(ArithmeticError):
    """The system is too ill-conditioned for double precision: relative error eps * bandwidth^4 near one."""


def second_difference(y: Array, step: Array) -> Array:
    """Return Q' y: differences of the slopes between neighbours; ``y`` (N), ``step`` (N - 1) gives (N - 2)."""
    slope = np.diff(y)
    slope /= step
    return np.diff(slope)


def _spread(u: Array, step: Array) -> Array:
    """Return Q u, shape (N), the adjoint of ``second_difference``."""
    slope = np.empty(len(step))
    slope[0], slope[-1] = u[0], -u[-1]
    np.subtract(u[1:], u[:-1], out=slope[1:-1])
    slope /= step
    out = np.empty(len(step) + 1)
    out[0], out[-1] = slope[0], -slope[-1]
    np.subtract(slope[1:], slope[:-1], out=out[1:-1])
    return out


@dataclass(frozen=True, eq=False)
class Solution:
    """u of eq. (32) for one p: ``v`` = D^2 Q u, the part of y smoothed away, and ``rss`` = |D^-1 v|^2.

    ``residual`` is the norm of Q' y - (Q' D^2 Q + p N) u relative to that of Q' y, and ``accuracy`` the relative error
    of u estimated from the last refinement step (both nan without refinement); ``slope`` is d log(rss) / d log(p),
    where it was requested.
    """

    p: float
    u: Array
    v: Array
    rss: float
    residual: float
    accuracy: float
    slope: float = np.nan


class System:
    """The matrices of eq. (32) for one time grid and one set of weights.

    ``step`` (N - 1) in units of the mean step; ``variance`` is the diagonal of D^2 (N), mean one, or None where all
    samples weigh the same. Reference: Reinsch (1967), eqs. (27)-(32) of the article.
    """

    def __init__(self, step: Array, variance: Array | None = None) -> None:
        self.step = step
        self.variance = variance
        self.size = len(step) - 1
        self._mass_diagonal = (2.0 / 3.0) * (step[:-1] + step[1:])
        self._mass_off = step[1:-1] / 3.0
        self._bands = self._gram(1.0 / step)

    def _gram(self, r: Array) -> Array:
        """Return the lower bands of Q' D^2 Q, shape (3, N - 2), in the order LAPACK wants."""
        bands = np.empty((3, self.size), order="F")
        middle = r[:-1] + r[1:]
        if (d := self.variance) is None:
            square = r * r
            bands[0] = middle * middle + square[:-1] + square[1:]
            bands[1, :-1] = -r[1:-1] * (middle[:-1] + middle[1:])
            bands[2, :-2] = r[1:-2] * r[2:-1]
        else:
            bands[0] = d[:-2] * r[:-1] ** 2 + d[1:-1] * middle**2 + d[2:] * r[1:] ** 2
            bands[1, :-1] = -r[1:-1] * (middle[:-1] * d[1:-2] + middle[1:] * d[2:-1])
            bands[2, :-2] = r[1:-2] * r[2:-1] * d[2:-2]
        bands[1, -1:] = bands[2, -2:] = 0.0
        return bands

    def mass(self, u: Array) -> Array:
        """Return N u, with the tridiagonal N of eq. (28)."""
        out = self._mass_diagonal * u
        if self.size > 1:
            out[:-1] += self._mass_off * u[1:]
            out[1:] += self._mass_off * u[:-1]
        return out

    def factor(self, p: float) -> Array:
        """Return the banded Cholesky factor of Q' D^2 Q + p N; IllConditionedError where it breaks down."""
        bands = self._bands.copy(order="F")
        bands[0] += p * self._mass_diagonal
        if self.size > 1:
            bands[1, :-1] += p * self._mass_off
        factor, info = lapack.dpbtrf(bands, lower=1, overwrite_ab=1)
        if info != 0:
            raise IllConditionedError(f"Cholesky factorisation broke down at row {info}")
        return factor  # type: ignore[no-any-return]

    def log_det(self, p: float) -> float:
        """Return log det(Q' D^2 Q + p N)."""
        return 2.0 * float(np.log(self.factor(p)[0]).sum())

    def smoothed_away(self, u: Array) -> Array:
        """Return D^2 Q u = y - g, shape (N)."""
        v = _spread(u, self.step)
        if self.variance is not None:
            v *= self.variance
        return v

    def solve(self, p: float, z: Array, *, refine: bool = True, slope: bool = False) -> Solution:
        """Solve eq. (32) for the right-hand side z = Q' y.

        With ``refine``, iterative refinement with the residual in factored form, Q' (D^2 Q u), takes the relative
        error of u from eps * m^4 (m the bandwidth in samples) to a few eps.
        """
        factor = self.factor(p)
        u = lapack.dpbtrs(factor, z, lower=1)[0]
        residual, accuracy, v = np.nan, np.nan, self.smoothed_away(u)
        if refine:
            u, v, residual, accuracy = self._refine(p, factor, z, u, v)
        rss = float(v @ v if self.variance is None else v @ (v / self.variance))
        return Solution(p, u, v, rss, residual, accuracy, self._slope(p, factor, u, rss) if slope else np.nan)

    def _refine(self, p: float, factor: Array, z: Array, u: Array, v: Array) -> tuple[Array, Array, float, float]:
        tiny = float(np.finfo(np.float64).tiny)
        last, left = 1.0, np.inf  # relative size of the last correction, and the error expected after it
        while True:
            residual = z - second_difference(v, self.step)
            residual -= p * self.mass(u)
            size = np.sqrt(float(residual @ residual) / max(float(z @ z), tiny))
            if left <= EPS:
                return u, v, size, EPS
            correction = lapack.dpbtrs(factor, residual, lower=1)[0]
            change = np.sqrt(float(correction @ correction) / max(float(u @ u), tiny))
            if change >= 0.5 * last:  # no further improvement at this precision
                if not change < 1e-8:
                    raise IllConditionedError(f"iterative refinement stops at a relative correction of {change:.1e}")
                return u, v, size, change
            u = u + correction
            v = self.smoothed_away(u)
            last, left = change, change * change / last

    def _slope(self, p: float, factor: Array, u: Array, rss: float) -> float:
        """Return d log(rss) / d log(p) = -2 p (u' N u - p w' w) / rss with R' w = N u (step 3 of the algorithm)."""
        mass_u = self.mass(u)
        w = lapack.dtbtrs(factor, mass_u[:, None], uplo="L")[0]
        return -2.0 * p * (float(u @ mass_u) - p * float(np.vdot(w, w))) / max(rss, np.finfo(float).tiny)

    def interpolate(self, z: Array) -> Array:
        """Solve N c = Q' y, eq. (22): the natural interpolating spline."""
        if self.size == 1:
            return z / self._mass_diagonal
        return lapack.dptsv(self._mass_diagonal, self._mass_off, z)[2]  # type: ignore[no-any-return]

    def edf(self, p: float) -> float:
        """Return the effective degrees of freedom, the trace of the map from y to g.

        trace = 2 + d log det(Q' D^2 Q + p N) / d log p, by a five-point difference (relative error about 1e-8).
        """
        h = 0.1
        value = [self.log_det(p * float(np.exp(k * h))) for k in (-2, -1, 1, 2)]
        return 2.0 + (value[0] - 8 * value[1] + 8 * value[2] - value[3]) / (12 * h)
