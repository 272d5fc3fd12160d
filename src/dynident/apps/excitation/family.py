"""Families of motions that are linear in their coefficients, which the optimiser chooses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from dynident.runtime import Noun
from dynident.runtime.arrays import Array

DEGREE = 5  # the jerk is continuous
REST_POINTS = 3  # equal control points at either end: there dq and ddq are zero


class LimitConstraints(Noun):
    """Finitely many linear constraints that keep a motion within its limits at all times.

    ``rows`` are four matrices (R, K), for q, dq, ddq and jerk. Where ``rows[d] @ x`` stays within middle +- ``share`` *
    half, the derivative d of the motion with coefficients x stays within middle +- half at all times.
    """

    rows: tuple[Array, Array, Array, Array]
    share: float


class Family(Protocol):
    """Motions q(t) = sum_k B_k(t) x_k, for each joint with its own K coefficients x (n, K).

    Examples are ``Fourier`` (periodic) and ``ClampedSpline`` (at rest at both ends). The first coefficient
    is a pose: it shifts the whole motion and leaves the others as they are.
    """

    @property
    def size(self) -> int:
        """Number K of coefficients of a joint."""

    @property
    def duration(self) -> float:
        """Length (s): one period, or the whole motion."""

    def values(self, t: Array, /) -> Array:
        """Return the functions and their first three derivatives, shape (4, N, K), at times t (N)."""

    def guard(self, points: int, /) -> LimitConstraints:
        """Return the constraints that keep a motion within its limits; more ``points`` leave less of them unused."""


class LinearCourse(Noun):
    """Motion of a family with coefficients ``x`` (n, K), once through."""

    family: Family
    x: Array

    @property
    def duration(self) -> float:
        """Its length (s)."""
        return self.family.duration

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        return np.asarray(self.family.values(t) @ self.x.T)


@dataclass(frozen=True)
class Fourier:
    """Series q(t) = x_0 + sum_k (x_{2k-1} sin k w t + x_{2k} cos k w t) / k, w = 2 pi / ``period`` (s).

    With the harmonics divided by their number, coefficients of equal size are velocities of equal size.

    >>> Fourier(10.0, 3).size
    7
    """

    period: float
    harmonics: int

    @property
    def size(self) -> int:
        """Number 2 ``harmonics`` + 1 of coefficients of a joint."""
        return 2 * self.harmonics + 1

    @property
    def duration(self) -> float:
        """One period (s)."""
        return self.period

    @property
    def harmonic_numbers(self) -> Array:
        """Number k of the harmonic of each coefficient but the first, shape (K - 1)."""
        return np.repeat(np.arange(1.0, self.harmonics + 1), 2)

    def values(self, t: Array) -> Array:
        """Return the functions and their first three derivatives, shape (4, N, K), at times t (N)."""
        frequency = 2 * np.pi / self.period * self.harmonic_numbers  # rad/s
        angles = np.multiply.outer(np.asarray(t, dtype=float), frequency)
        angles[:, 1::2] += np.pi / 2  # cos is sin a quarter later
        out = np.zeros((4, len(angles), self.size))
        out[0, :, 0] = 1.0
        for d in range(4):
            # a derivative advances the phase by a quarter period and multiplies by the frequency
            out[d, :, 1:] = np.sin(angles + d * np.pi / 2) * frequency**d / self.harmonic_numbers
        return out

    def guard(self, points: int) -> LimitConstraints:
        """Return the values at ``points`` times spread evenly over the period, and the share that they may reach.

        A trigonometric polynomial of degree H whose absolute value is largest at one time has, a time s before
        or after, at least cos(H w s) of that (J. G. van der Corput and G. Schaake, Compositio Mathematica 2,
        1935). Some point of the grid is at most half a step away.
        """
        q, dq, ddq, jerk = self.values(np.arange(points) * self.period / points)
        return LimitConstraints((q, dq, ddq, jerk), float(np.cos(np.pi * self.harmonics / points)))

    def shift(self, x: Array, t: float) -> Array:
        """Return the coefficients (n, K) of the motion with coefficients x (n, K) when it begins at time t."""
        angles = 2 * np.pi * t / self.period * np.arange(1.0, self.harmonics + 1)
        cos, sin = np.cos(angles), np.sin(angles)
        a, b = x[:, 1::2], x[:, 2::2]
        shifted_x = np.array(x, dtype=float)
        shifted_x[:, 1::2], shifted_x[:, 2::2] = a * cos - b * sin, a * sin + b * cos
        return shifted_x


@dataclass(frozen=True)
class ClampedSpline:
    """Splines of degree 5 over ``spans`` (2 or more) equal intervals of ``duration`` (s).

    x_0 is the pose at both ends, x_1 ... are the control points between them less that pose.

    >>> ClampedSpline(10.0, 12).size
    12
    """

    duration: float
    spans: int

    @property
    def size(self) -> int:
        """Number of coefficients of a joint: as many as spans."""
        return self.spans

    def values(self, t: Array) -> Array:
        """Return the functions and their first three derivatives, shape (4, N, K), at times t (N)."""
        from scipy.interpolate import BSpline

        # the knots of degree 5 at both ends are multiple, so that the spline begins and ends at its control points
        spline = BSpline(self._knots(1), self._tie_matrix, DEGREE)
        return np.stack([spline(np.asarray(t, dtype=float), nu=d) for d in range(4)])

    def guard(self, points: int) -> LimitConstraints:
        """Return the control points of the motion and its derivatives on knots refined to about ``points``.

        A spline lies between the least and the greatest of its control points (C. de Boor, "A practical guide to
        splines", chapter IX); refined, they come close to it.
        """
        knots = self._knots(max(1, round(points / self.spans)))
        # each derivative has a degree less, and one knot less at either end
        q, dq, ddq, jerk = (self._control_points(knots[d : len(knots) - d], d) for d in range(4))
        return LimitConstraints((q, dq, ddq, jerk), 1.0)

    def _control_points(self, knots: Array, d: int) -> Array:
        """Return the control points (R, K) of the derivatives of order ``d`` of the functions on finer knots."""
        from scipy.interpolate import BSpline

        degree = DEGREE - d
        # the Greville abscissae, at which interpolation by splines is well posed
        sites = np.lib.stride_tricks.sliding_window_view(knots[1:-1], degree).mean(axis=1)
        matrix = BSpline.design_matrix(sites, knots, degree).toarray()
        return np.asarray(np.linalg.solve(matrix, self.values(sites)[d]))

    @cached_property
    def _tie_matrix(self) -> Array:
        """Control points (K + 5, K) of the functions: three equal ones at either end."""
        matrix = np.zeros((self.spans + DEGREE, self.spans))
        matrix[:, 0] = 1.0
        matrix[REST_POINTS:-REST_POINTS, 1:] = np.eye(self.spans - 1)
        return matrix

    def _knots(self, parts: int) -> Array:
        """Return the knots, with each span in equal parts."""
        inner = np.linspace(0.0, self.duration, self.spans * parts + 1)
        return np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, self.duration)])
