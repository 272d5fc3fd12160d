"""Finite Fourier series: motions that repeat, so that their periods can be averaged.

J. Swevers, C. Ganseman, D. B. Tükel, J. De Schutter and H. Van Brussel, "Optimal robot excitation and
identification", IEEE Transactions on Robotics and Automation 13(5), 1997.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.excitation.trajectories.family import Guard, LinearCourse

__all__ = ["Fourier"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fourier:
    """Series q(t) = x_0 + sum_k (x_{2k-1} sin k w t + x_{2k} cos k w t) / k, w = 2 pi / ``period`` (s).

    With the harmonics divided by their number, coefficients of equal size are velocities of equal size.

    >>> Fourier(10.0, 3).size
    7
    """

    period: float
    harmonics: int

    def __post_init__(self) -> None:
        if not 0 < self.period < np.inf:
            raise ConfigError(f"period is {self.period:g} s; give a time above 0.")
        if self.harmonics < 1:
            raise ConfigError(f"harmonics is {self.harmonics}; give 1 or more.")

    @property
    def size(self) -> int:
        """The number 2 ``harmonics`` + 1 of coefficients of a joint."""
        return 2 * self.harmonics + 1

    @property
    def duration(self) -> float:
        """One period (s)."""
        return self.period

    @property
    def order(self) -> Array:
        """The number k of the harmonic of each coefficient but the first, shape (K - 1)."""
        return np.repeat(np.arange(1.0, self.harmonics + 1), 2)

    def values(self, t: Array) -> Array:
        """Return the functions and their first three derivatives, shape (4, N, K), at times t (N)."""
        frequency = 2 * np.pi / self.period * self.order  # rad/s
        angles = np.multiply.outer(np.asarray(t, dtype=float), frequency)
        angles[:, 1::2] += np.pi / 2  # cos is sin a quarter later
        out = np.zeros((4, len(angles), self.size))
        out[0, :, 0] = 1.0
        for d in range(4):
            out[d, :, 1:] = np.sin(angles + d * np.pi / 2) * frequency**d / self.order
        return out

    def guard(self, points: int) -> Guard:
        """Return the values at ``points`` times spread evenly over the period, and the share that they may reach.

        A trigonometric polynomial of degree H whose size is largest at one time has, a time s before or after, at least
        cos(H w s) of that (J. G. van der Corput and G. Schaake, Compositio Mathematica 2, 1935); some point of the grid
        is no farther than half a step away.
        """
        if points <= 2 * self.harmonics:
            raise ConfigError(f"a guard of {self.harmonics} harmonics takes more than {2 * self.harmonics} points.")
        q, dq, ddq, jerk = self.values(np.arange(points) * self.period / points)
        return Guard((q, dq, ddq, jerk), float(np.cos(np.pi * self.harmonics / points)))

    def shifted(self, x: Array, t: float) -> Array:
        """Return the coefficients (n, K) of the motion that begins at time t of that with coefficients x (n, K)."""
        angles = 2 * np.pi * t / self.period * np.arange(1.0, self.harmonics + 1)
        cos, sin = np.cos(angles), np.sin(angles)
        a, b = x[:, 1::2], x[:, 2::2]
        out = np.array(x, dtype=float)
        out[:, 1::2], out[:, 2::2] = a * cos - b * sin, a * sin + b * cos
        return out

    def course(self, x: Array) -> LinearCourse:
        """Return one period with coefficients x (n, K)."""
        return LinearCourse(self, np.asarray(x, dtype=float))
