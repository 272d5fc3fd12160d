"""One column of data in scaled units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from math import isnan, log2, nan, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.motion.splines.banded import EPS, Solution, System
from dynident.motion.splines.compiled import CHUNK_SAMPLES, column_ranges, roughness, scale_columns
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

NORMAL_95 = 1.959964  # standard deviations to each side that hold 95 % of a normal distribution
CUTOFF_POWER = np.sqrt(2.0) - 1.0  # (2 pi f bandwidth)^(2 order) at the cut-off
MAX_FREQUENCIES, MIN_FREQUENCIES = 4000, 20
MIN_GRID_STEPS = 30  # with fewer steps a grid is not told from chance
MIN_GRID_SHARE, MAX_GRID_COUNT = 0.95, 1000  # share of the steps, of at most so many counts, that must be whole
SIGMA_PER_MEDIAN = 1.4826  # standard deviation of a normal distribution over the median of its absolute value


def noise_sigma(t: ArrayLike, y: ArrayLike, weights: ArrayLike | None = None, *, order: int = 4) -> NDArray[np.float64]:
    """Estimate the noise standard deviation of each column from divided differences on the actual times.

    ``t`` (N) increasing, ``y`` (N,) or (N, k), ``weights`` None, (N,) or (N, k): a sample's standard deviation is
    sigma / sqrt(weight). Returns sigma (k,), in the unit of y. The divided difference of ``order``
    over neighbouring samples removes a polynomial of lower degree; divided by the norm of its coefficients it has the
    variance of the noise. The estimate is its root mean square (Gasser, Sroka and Jennen-Steinmetz, 1986, for order 2
    and a non-uniform design; Hall, Kay and Titterington, 1990, for higher orders).

    Limits: the noise must be white. The error of a quantised encoder is neither white nor Gaussian: it is constant at
    rest and follows the motion at low speed, so that the estimate is too small there; coloured noise (a filter in the
    drive) is underestimated too. With too low a sampling rate the signal's own differences add to it, and the estimate
    is too large. It is at least the rounding of the data, 4 eps max |y|. Raises InputError for fewer than order + 2
    samples.
    """
    time = np.asarray(t, dtype=float)
    data = np.asarray(y, dtype=float).reshape(len(time), -1)
    if len(time) < order + 2:
        raise InputError(f"estimating the noise needs at least {order + 2} samples, got {len(time)}.")
    weight = np.ones((len(time), 1)) if weights is None else np.asarray(weights, float).reshape(len(time), -1)
    squares = roughness(time, data, weight) if order == 4 else None
    sigma = np.sqrt(_difference_power(time, data, weight, order) if squares is None else squares)
    low, high, _ = column_ranges(np.ascontiguousarray(data))
    rounding = 4 * np.finfo(float).eps * np.maximum(high, np.negative(low))
    return np.asarray(np.maximum(sigma, np.maximum(rounding, 1e-100)))


def _difference_power(time: Array, data: Array, weight: Array, order: int) -> Array:
    """Return the mean squares of divided differences, each over its variance."""
    count = len(time) - order
    # the coefficients of a divided difference are 1 / prod(t_i - t_j), here in units of its span
    position = np.lib.stride_tricks.sliding_window_view(time, order + 1)
    coefficients = np.ones((order + 1, count))
    for i in range(order + 1):
        for j in range(order + 1):
            if i != j:
                coefficients[i] /= (position[:, i] - position[:, j]) / (position[:, -1] - position[:, 0])
    difference, variance = np.zeros((count, data.shape[1])), np.zeros((count, weight.shape[1]))
    for i in range(order + 1):
        difference += coefficients[i][:, None] * data[i : i + count]
        variance += coefficients[i][:, None] ** 2 / weight[i : i + count]
    return np.asarray(np.mean(difference**2 / variance, axis=0))


def coloured_noise(
    t: ArrayLike, y: ArrayLike, removed: ArrayLike, bandwidth: ArrayLike, order: int = 2
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return deviation (k) and correlation of neighbours (k, 0 to 0.98) of the noise in y (N, k), taken as AR(1).

    ``removed`` (N, k) is what splines of these bandwidths (k, s), of degree 2 ``order`` - 1, have smoothed away.
    Its spectrum is compared with that of AR(1) (Whittle's likelihood) above twice the cut-off, where it is noise
    alone, and nearly all of it. Where too few frequencies remain, nothing was smoothed away, or the spectrum is
    not that of AR(1), the noise is that of ``noise_sigma``, and white.
    """
    time, residual, width = (np.asarray(x, dtype=float) for x in (t, removed, bandwidth))
    sigma, rho = noise_sigma(time, y), np.zeros(residual.shape[1])
    step = float(time[-1] - time[0]) / (len(time) - 1)
    rho_grid = np.linspace(0.0, 0.98, 99)
    # Hann's window keeps the power of the motion from leaking into the frequencies of the noise
    power = np.square(np.abs(np.fft.rfft(residual * np.hanning(len(residual))[:, None], axis=0)))
    power /= np.square(np.hanning(len(residual))).sum()
    angle = 2 * np.pi * np.arange(len(power)) / len(residual)
    for k in np.flatnonzero(np.isfinite(width) & (sigma > 0)):  # a joint that stands still is smoothed without limit
        # above twice the cut-off there is nearly only noise; undo the spline's gain there before the fit
        attenuation = (angle * width[k] / step) ** (2 * order)
        usable = np.flatnonzero(attenuation > 4.0**order * CUTOFF_POWER)
        usable = usable[:: max(1, len(usable) // MAX_FREQUENCIES)]
        if len(usable) < MIN_FREQUENCIES or not power[usable, k].any():
            continue
        noise_power = power[usable, k] * (1 + 1 / attenuation[usable]) ** 2
        # spectrum of AR(1) on a grid of rho, the innovation variance profiled out
        shape = 1 + rho_grid[:, None] ** 2 - 2 * rho_grid[:, None] * np.cos(angle[usable])
        innovation = (noise_power * shape).mean(axis=1)
        best = int(np.argmin(np.log(innovation) - np.log(shape).mean(axis=1)))
        if best == len(rho_grid) - 1:  # not noise, but motion that was smoothed away
            continue
        sigma[k], rho[k] = np.sqrt(innovation[best] / (1 - rho_grid[best] ** 2)), rho_grid[best]
    return sigma, rho


def median_sigma(x: ArrayLike) -> NDArray[np.float64]:
    """Return the standard deviation (k) of x (N, k), normal about zero with outliers, from median absolute values."""
    return np.asarray(SIGMA_PER_MEDIAN * np.median(np.abs(np.asarray(x, dtype=float)), axis=0))


def steady_noise(x: NDArray[np.float64], min_share: float) -> NDArray[np.float64]:
    """Return the noise's standard deviation (k) of evenly sampled x (N, k), from the median of its fourth differences.

    The median ignores the few samples after a step. White noise is assumed. The result is at least ``least_noise``.
    """
    sigma = median_sigma(np.diff(x, 4, axis=0)) / np.linalg.norm([1.0, -4.0, 6.0, -4.0, 1.0])
    # rounding bounds the estimate from below, also for a channel that is constant
    return np.asarray(np.maximum(sigma, least_noise(x, min_share)))


def least_noise(x: NDArray[np.float64], min_share: float) -> NDArray[np.float64]:
    """Return ``min_share`` times each channel's largest value (k) of x (N, k), or where it is zero, that of all."""
    size = np.abs(x).max(axis=0)
    return np.asarray(min_share * np.where(size > 0, size, size.max() or 1.0))


def grid_step(x: Array) -> float:
    """Return the step of the grid on which the values (N) lie, nan where they lie on none: that of an encoder."""
    steps = np.abs(np.diff(x))
    steps = steps[steps > 1e-9 * np.ptp(x)]  # shorter ones are rounding of the arithmetic
    if len(steps) < MIN_GRID_STEPS:
        return float("nan")
    # the values lie on a grid where nearly all steps are whole multiples of the smallest one
    counts = steps / steps.min()
    counts = counts[counts < MAX_GRID_COUNT]  # in larger ones the rounding of the smallest step adds up
    on_grid = len(counts) >= MIN_GRID_STEPS and np.mean(np.abs(counts - np.round(counts)) < 0.05) >= MIN_GRID_SHARE
    return float(steps.min()) if on_grid else float("nan")


ROUNDING_FACTOR = 6.0  # of a slope, its step and the residual, in units of EPS


class ScaledSeries(Noun):
    """One column of data in scaled units, with the factors to convert back.

    y (N) is the data less the first of them, divided by ``size`` (a power of two), ``z`` = Q' y, ``noise`` the
    root mean square of delta and ``rounding`` the last digit of the data, both divided by ``size``; ``step`` is
    the mean step in the user's unit of time; p of eq. (15) is ``p_scale`` times the scaled one. ``slope_norm`` is
    the norm of the slopes of y, ``line_rss`` is ``straight_rss`` where it is known, else nan.
    """

    system: System
    data: Array
    z: Array
    noise: float
    size: float
    step: float
    rounding: float
    slope_norm: float
    line_rss: float

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
    ) -> list[ScaledSeries]:
        """Scale columns (N, k), of which ``low`` and ``high`` (k) are the least and the largest value.

        ``noise`` (k) is the root mean square of delta in the unit of the data.
        """
        # a power of two as the unit loses no digits
        extents = [max(b - y, y - a) for a, b, y in zip(low, high, columns[0].tolist(), strict=True)]
        size = [2.0 ** round(log2(extent)) if extent > 0 else 1.0 for extent in extents]
        z, slope_norms, line_rss = scale_columns(systems[0].grid, t, columns, [1.0 / extent for extent in size])
        weighted = systems[0].variance is not None
        return [
            cls(
                systems[k], columns[:, k], z[k], noise[k] / unit, unit, step,
                EPS * max(-low[k], high[k]) / unit, slope_norms[k], nan if weighted else line_rss[k],
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
        sigma, h = self.noise * self.size, self.step
        return sigma * sigma / (h * h * h)

    def middle_part(self) -> ScaledSeries | None:
        """Return the middle of the data, from which a search may start, or None where the data are short."""
        n = len(self.data)
        if n < 4 * CHUNK_SAMPLES:
            return None
        part = slice((n - CHUNK_SAMPLES) // 2, (n - CHUNK_SAMPLES) // 2 + CHUNK_SAMPLES)
        return replace(self, system=self.system.part(part), data=self.data[part], z=self.z[part][:-2], line_rss=np.nan)

    def line(self) -> Array:
        """Return the weighted least-squares straight line at the samples (the limit p = 0)."""
        axis = self.system.axis
        mean = float(axis.w @ self.y) / axis.total
        return np.asarray(mean + axis.x * (float(axis.wx @ self.y - mean * axis.wx.sum()) / axis.square))

    @cached_property
    def straight_rss(self) -> float:
        """Weighted sum of squares that the straight line leaves, |D^-1 (y - line)|^2."""
        return self.system.weighted_rss(self.y - self.line()) if np.isnan(self.line_rss) else self.line_rss

    @cached_property
    def is_straight(self) -> bool:
        """Whether the data are a straight line to within rounding."""
        # the largest distance that rounding of the data, and of the sums, explains
        tolerance = 4 * self.rounding + EPS * (64 + len(self.data))
        if self.line_rss > len(self.data) * tolerance**2:
            return False  # else no value were farther from the line
        return float(np.abs(self.y - self.line()).max()) <= tolerance

    def straight_solution(self) -> Solution:
        """Return the straight line as a solution with p = 0 and no curvature."""
        rss = self.system.weighted_rss(self.y - self.line())
        return Solution(0.0, np.zeros(self.system.size), rss, 0.0, 0.0)

    def accuracy(self, solution: Solution) -> float:
        """Return a bound of the relative error of u.

        It covers rounding, the last correction, and errors of the slopes of y and of the part smoothed away.

        Of slopes with an error ds, A u = Q' y makes A^-1 B ds with the first differences B; where steps and weights
        are even, waves of frequency f are multiplied by f / (f^4 + p), at most 3^(3/4) / 4 p^(-3/4), and of N samples
        have f > 4.73 / N. For uneven steps the widest, and for weights the largest, are taken for all.
        """
        if solution.p == 0 or solution.u is None:
            return solution.accuracy
        step, variance = self.system.step, self.system.variance
        if solution.p == np.inf:
            gain = 3.0 / float(step.min())
        # the narrowest kernel amplifies errors of the slopes most; a short log limits it
        else:
            min_variance = 1.0 if variance is None else float(variance.min())
            gain = 0.57 * min(solution.p**-0.75 * min_variance**-0.25, (len(step) / 4.73) ** 3 / min_variance)
            gain *= sqrt(step.max())
        size = float(np.sqrt(solution.u @ solution.u)) if isnan(solution.norm) else solution.norm
        return (
            max(solution.accuracy, EPS * (4.0 + ROUNDING_FACTOR * gain * self.slope_norm / size))
            if size > 0
            else solution.accuracy
        )
