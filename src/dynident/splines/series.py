"""One column of data in scaled units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.splines import compiled
from dynident.splines.banded import EPS, Grid, Solution, System

__all__ = ["CHUNK", "Series"]

Array = NDArray[np.float64]
CHUNK = 4096
CLEAR = 1e-4  # share of the sum of squares from which on what a line leaves may be had by subtraction


@dataclass(frozen=True, eq=False)
class Series:
    """One column of data in scaled units, with the factors to convert back.

    ``y`` (N) is the data less the first of them, divided by ``size`` (a power of two), ``z`` = Q' y, ``noise`` the
    root mean square of delta and ``rounding`` the last digit of the data, both divided by ``size``; ``step`` is the
    mean step in the user's unit of time; p of eq. (15) is ``p_scale`` times the scaled one.
    """

    system: System
    y: Array
    z: Array
    noise: float
    size: float
    step: float
    rounding: float

    @classmethod
    def of(
        cls, systems: Sequence[System], columns: Array, noise: Sequence[float], step: float, low: Array, high: Array
    ) -> list[Series]:
        """Scale columns (N, k), of which ``low`` and ``high`` (k) are the least and the largest value.

        ``noise`` (k) is the root mean square of delta in the unit of the data.
        """
        reach = np.maximum(high - columns[0], columns[0] - low)
        size = np.exp2(np.round(np.log2(np.where(reach > 0, reach, 1.0))))
        y, z = compiled.scaled(systems[0].grid, columns, 1.0 / size)
        rounding = EPS * np.maximum(np.abs(low), np.abs(high)) / size
        return [
            cls(system, y[k], z[k], float(noise[k] / size[k]), float(size[k]), step, float(rounding[k]))
            for k, system in enumerate(systems)
        ]

    @property
    def p_scale(self) -> float:
        """p of eq. (15) over the scaled p."""
        return (self.noise * self.size) ** 2 / self.step**3

    @cached_property
    def norm(self) -> float:
        """|Q' y|."""
        return float(np.sqrt(self.z @ self.z))

    def central(self) -> Series | None:
        """Return the middle of the data, from which a search may start, or None where the data are short."""
        n = len(self.y)
        if n < 4 * CHUNK:
            return None
        part = slice((n - CHUNK) // 2, (n - CHUNK) // 2 + CHUNK)
        return replace(self, system=self.system.part(part), y=self.y[part], z=self.z[part][:-2])

    def line(self) -> Array:
        """Return the weighted least-squares straight line at the samples (the limit p = 0)."""
        mean, slope = self._line
        return np.asarray(mean + self.system.axis.x * slope)

    @cached_property
    def _line(self) -> tuple[float, float]:
        axis = self.system.axis
        mean = float(axis.w @ self.y) / axis.total
        return mean, float(axis.wx @ self.y - mean * axis.wx.sum()) / axis.square

    @cached_property
    def straight_rss(self) -> float:
        """What the straight line leaves, |D^-1 (y - line)|^2."""
        mean, slope = self._line
        axis = self.system.axis
        whole = float(self.y @ self.y if self.system.variance is None else self.y @ (self.y * axis.w))
        left = whole - axis.total * mean * mean - axis.square * slope * slope
        return left if left > CLEAR * whole else self.system.weighed(self.y - self.line())

    @cached_property
    def is_straight(self) -> bool:
        """Whether the data are a straight line to within rounding."""
        least = 4 * self.rounding + EPS * (64 + len(self.y))
        if self.system.variance is None and self.straight_rss > len(self.y) * least**2:
            return False  # else no value were farther from the line
        return float(np.abs(self.y - self.line()).max()) <= least

    def straight(self) -> Solution:
        """Return the straight line as a solution with p = 0 and no curvature."""
        return Solution(0.0, np.zeros(self.system.size), self.straight_rss, 0.0, 0.0)
