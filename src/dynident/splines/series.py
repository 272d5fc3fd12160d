"""One column of data in scaled units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isnan, log2, nan

import numpy as np
from numpy.typing import NDArray

from dynident.splines.banded import EPS, Solution, System
from dynident.splines.compiled import scaled

__all__ = ["CHUNK", "Series"]

Array = NDArray[np.float64]
CHUNK = 4096
ROUNDINGS = 6.0  # of a slope, its step and the residual, in units of EPS


@dataclass(frozen=True, eq=False)
class Series:
    """One column of data in scaled units, with the factors to convert back.

    y (N) is the data less the first of them, divided by ``size`` (a power of two), ``z`` = Q' y, ``noise`` the root
    mean square of delta and ``rounding`` the last digit of the data, both divided by ``size``; ``step`` is the mean
    step in the user's unit of time; p of eq. (15) is ``p_scale`` times the scaled one. ``steep`` is the norm of the
    slopes of y, ``left`` is ``straight_rss`` where it is known, else nan.
    """

    system: System
    data: Array
    z: Array
    noise: float
    size: float
    step: float
    rounding: float
    steep: float
    left: float

    @classmethod
    def of(
        cls,
        systems: Sequence[System],
        t: Array,
        columns: Array,
        noise: Sequence[float],
        step: float,
        low: Sequence[float],
        high: Sequence[float],
    ) -> list[Series]:
        """Scale columns (N, k), of which ``low`` and ``high`` (k) are the least and the largest value.

        ``noise`` (k) is the root mean square of delta in the unit of the data.
        """
        reach = [max(b - y, y - a) for a, b, y in zip(low, high, columns[0].tolist(), strict=True)]
        size = [2.0 ** round(log2(one)) if one > 0 else 1.0 for one in reach]
        z, steep, left = scaled(systems[0].grid, t, columns, [1.0 / one for one in size])
        weighted = systems[0].variance is not None
        return [
            cls(
                systems[k], columns[:, k], z[k], noise[k] / unit, unit, step,
                EPS * max(-low[k], high[k]) / unit, steep[k], nan if weighted else left[k],
            )
            for k, unit in enumerate(size)
        ]  # fmt: skip

    @cached_property
    def y(self) -> Array:
        """The data (N) less the first of them, in units of ``size``."""
        y: Array = self.data - self.data[0]
        y /= self.size
        return y

    @property
    def p_scale(self) -> float:
        """p of eq. (15) over the scaled p."""
        return (self.noise * self.size) ** 2 / self.step**3

    def central(self) -> Series | None:
        """Return the middle of the data, from which a search may start, or None where the data are short."""
        n = len(self.data)
        if n < 4 * CHUNK:
            return None
        part = slice((n - CHUNK) // 2, (n - CHUNK) // 2 + CHUNK)
        return replace(self, system=self.system.part(part), data=self.data[part], z=self.z[part][:-2], left=np.nan)

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
        return self.system.weighed(self.y - self.line()) if np.isnan(self.left) else self.left

    @cached_property
    def is_straight(self) -> bool:
        """Whether the data are a straight line to within rounding."""
        least = 4 * self.rounding + EPS * (64 + len(self.data))
        if self.left > len(self.data) * least**2:
            return False  # else no value were farther from the line
        return float(np.abs(self.y - self.line()).max()) <= least

    def straight(self) -> Solution:
        """Return the straight line as a solution with p = 0 and no curvature."""
        rss = self.system.weighed(self.y - self.line())
        return Solution(0.0, np.zeros(self.system.size), rss, 0.0, 0.0)

    def accuracy(self, found: Solution) -> float:
        """Return a bound of the relative error of u: of rounding, of the last correction, and of the slopes, of y and
        of what is smoothed away, with their steps.

        Of slopes with an error ds, A u = Q' y makes A^-1 B ds with the first differences B; where steps and weights are
        even, waves of frequency f are multiplied by f / (f^4 + p), at most 3^(3/4) / 4 p^(-3/4), and of N samples have
        f > 4.73 / N. Of uneven steps the widest, and of weights the largest, are taken for all.
        """
        if found.p == 0 or found.u is None:
            return found.accuracy
        step, variance = self.system.step, self.system.variance
        if found.p == np.inf:
            gain = 3.0 / float(step.min())
        else:
            least = 1.0 if variance is None else float(variance.min())
            gain = 0.57 * min(found.p**-0.75 * least**-0.25, (len(step) / 4.73) ** 3 / least)
            gain *= float(step.max()) ** 0.5
        size = float(np.sqrt(found.u @ found.u)) if isnan(found.norm) else found.norm
        return max(found.accuracy, EPS * (4.0 + ROUNDINGS * gain * self.steep / size)) if size > 0 else found.accuracy
