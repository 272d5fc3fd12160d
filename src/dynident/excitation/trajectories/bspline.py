"""Clamped B-splines: motions that begin and end at rest in the same pose, without a period of their own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.excitation.trajectories.family import Guard, LinearCourse

__all__ = ["Clamped"]

Array = NDArray[np.float64]
DEGREE = 5  # the jerk is continuous
TIED = 3  # equal control points at either end: there dq and ddq are zero


@dataclass(frozen=True)
class Clamped:
    """Splines of degree 5 over ``spans`` (2 or more) equal intervals of ``duration`` (s).

    x_0 is the pose at both ends, x_1 ... are the control points between them less that pose.

    >>> Clamped(10.0, 12).size
    12
    """

    duration: float
    spans: int

    def __post_init__(self) -> None:
        if not 0 < self.duration < np.inf:
            raise ConfigError(f"the duration of a spline is {self.duration:g} s; give a time above 0.")
        if self.spans < 2:
            raise ConfigError(f"a spline has {self.spans} spans; give 2 or more.")

    @property
    def size(self) -> int:
        """The number of coefficients of a joint: as many as spans."""
        return self.spans

    def values(self, t: Array) -> Array:
        """Return the functions and their first three derivatives, shape (4, N, K), at times t (N)."""
        from scipy.interpolate import BSpline

        spline = BSpline(self._knots(1), self._tie, DEGREE)
        return np.stack([spline(np.asarray(t, dtype=float), nu=d) for d in range(4)])

    def guard(self, points: int) -> Guard:
        """Return the control points of the motion and its derivatives on knots refined to about ``points``.

        A spline lies between the least and the greatest of its control points (C. de Boor, "A practical guide to
        splines", chapter IX); refined, they come close to it.
        """
        knots = self._knots(max(1, round(points / self.spans)))
        q, dq, ddq, jerk = (self._control_points(knots[d : len(knots) - d], d) for d in range(4))
        return Guard((q, dq, ddq, jerk), 1.0)

    def course(self, x: Array) -> LinearCourse:
        """Return the motion with coefficients x (n, K)."""
        return LinearCourse(self, np.asarray(x, dtype=float))

    def _control_points(self, knots: Array, d: int) -> Array:
        """Return the control points (R, K) of the functions' derivatives ``d`` on finer knots."""
        from scipy.interpolate import BSpline

        degree = DEGREE - d
        sites = np.lib.stride_tricks.sliding_window_view(knots[1:-1], degree).mean(axis=1)
        matrix = BSpline.design_matrix(sites, knots, degree).toarray()
        return np.asarray(np.linalg.solve(matrix, self.values(sites)[d]))

    @cached_property
    def _tie(self) -> Array:
        """The control points (K + 5, K) of the functions."""
        tie = np.zeros((self.spans + DEGREE, self.spans))
        tie[:, 0] = 1.0
        tie[TIED:-TIED, 1:] = np.eye(self.spans - 1)
        return tie

    def _knots(self, parts: int) -> Array:
        """Return the knots, with each span in equal parts."""
        inner = np.linspace(0.0, self.duration, self.spans * parts + 1)
        return np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, self.duration)])
