"""The period of a motion that repeats, from the positions alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.smoothers.harmonics import LINES, HarmonicSeries, fitted_series, spectrum, taken

__all__ = ["Period", "likely_periods", "refined"]

Array = NDArray[np.float64]
GRID = 4096  # samples on which periods are looked for
ALIKE = 0.3  # of the variance: two stretches that differ by less may be two periods
LONGEST = 0.55  # of a log: two periods, and what a lag may be wrong by
MOST = 12  # periods that are tried
FEW = 16  # harmonics by which they are told apart
WIDER = 3.0  # times longer stretches, one after the other, until the period is that of the whole log
BETTER = 2.0  # times less is left of a motion by a longer period, where the shorter is none
STRETCH = 4.2  # periods in the middle of a log by which candidates are told apart
DIVISORS, SHORTEST = 24, 6.0  # periods are divided by less; and are of more samples
NEAR = np.linspace(-1.0, 1.0, 17)  # steps of the grid around a lag
ROUNDS = 12


@dataclass(frozen=True)
class Period:
    """A period (s) with its standard error."""

    value: float
    std: float


def likely_periods(t: Array, q: Array) -> list[float]:
    """Return periods (s) of q (N, k), the most likely first; each column counts alike.

    The candidates are lags at which the motion is most like itself, and what divides the best of them. The shortest
    comes first of which a series leaves no more than twice what that of any other leaves; then those that leave least.
    """
    grid = np.linspace(t[0], t[-1], min(GRID, len(t)))
    y = np.stack([np.interp(grid, t, column) for column in q.T], axis=1)
    y = (y - y.mean(axis=0)) / y.std(axis=0)
    step = grid[1] - grid[0]
    found = []
    for lag in _lags(y)[:MOST]:
        near = [(lag + more) * step for more in NEAR]
        stretch = _middle(grid, STRETCH * near[-1])
        found.append(_tried(grid, y, min(near, key=lambda one: _left(grid[stretch], y[stretch], one))))
    if not found:
        return []
    best = min(found)[1]
    found += [(_left(grid, y, best / k), best / k) for k in range(2, DIVISORS) if best / k > SHORTEST * step]
    least = min(left for left, _ in found)
    first = min(period for left, period in found if left <= BETTER * least)
    return [first, *(period for _, period in sorted(found) if period != first)]


def _tried(t: Array, y: Array, period: float) -> tuple[float, float]:
    """Return what a series near a period leaves, and its period."""
    try:
        period = refined(t, y, period, _few(t, period), np.ones(y.shape[1])).value
    except np.linalg.LinAlgError:
        return np.inf, period
    return _left(t, y, period), period


def _few(t: Array, period: float) -> int:
    return int(min(FEW, 0.4 * period / (t[1] - t[0])))


def _lags(y: Array) -> NDArray[np.intp]:
    """Return the lags (samples) at which the columns of y (N, k) are most like themselves, the most alike first."""
    from scipy.fft import irfft, next_fast_len, rfft

    count = len(y)
    size = next_fast_len(2 * count, real=True)
    product = irfft(np.square(np.abs(rfft(y, size, axis=0))), size, axis=0)[:count].sum(axis=1)
    squares = np.concatenate([[0.0], np.cumsum(np.square(y).sum(axis=1))])
    lag = np.arange(count)
    pairs = squares[count - lag] + squares[-1] - squares[lag] - 2.0 * product
    apart = pairs / (2.0 * np.maximum(count - lag, 1) * y.shape[1])
    inner = apart[1:-1]
    least = np.flatnonzero((inner <= apart[:-2]) & (inner < apart[2:]) & (inner < ALIKE)) + 1
    least = least[(least > 4) & (least <= LONGEST * count)]
    return np.asarray(least[np.argsort(apart[least], kind="stable")])


def _middle(t: Array, length: float) -> slice:
    """Return the rows of so many seconds in the middle."""
    inside = np.flatnonzero(np.abs(t - (t[0] + t[-1]) / 2) <= length / 2)
    return slice(int(inside[0]), int(inside[-1]) + 1)


def _left(t: Array, y: Array, period: float) -> float:
    """Return the mean square of y that a series of this period leaves, inf where it is not determined."""
    try:
        series = fitted_series(t, y, period, _few(t, period))
    except np.linalg.LinAlgError:
        return np.inf
    return float(np.square(y - series(t, 0)[0]).mean())


def refined(t: Array, q: Array, period: float, harmonics: int, noise: Array) -> Period:
    """Return the period of least squares near the given one; columns count by their ``noise`` (k).

    A stretch in the middle is fitted first, then longer ones, since a small error of the period is a large one of the
    phase after many.
    """
    length, whole = STRETCH * period, float(t[-1] - t[0])
    while length < whole / WIDER:
        rows = _middle(t, length)
        period = _newton(t[rows], q[rows], period, harmonics, noise).value
        length *= WIDER
    return _newton(t, q, period, harmonics, noise)


def _newton(t: Array, q: Array, period: float, harmonics: int, noise: Array) -> Period:
    """Return the period of least squares by Gauss and Newton.

    The derivative of a series by the logarithm of its period is -(t - middle) dq, less what the series itself can
    follow. The standard error takes the noise as it is, white or not, by its spectrum.
    """
    std = 0.0
    for _ in range(ROUNDS):
        series = fitted_series(t, q, period, harmonics)
        value, slope = series(t, 1)
        left = (q - value) / noise
        moved = (t - series.middle)[:, None] * slope / noise
        moved -= _again(t, moved, series)
        size = float(np.square(moved).sum())
        if not size > 0:
            break
        change = -float((moved * left).sum()) / size
        std = period * np.sqrt(_variance(t, moved, left, period)) / size
        period *= 1.0 + float(np.clip(change, -0.01, 0.01))
        if abs(change) * period <= 1e-3 * std or abs(change) < 1e-13:
            break
    return Period(float(period), float(std))


def _again(t: Array, x: Array, like: HarmonicSeries) -> Array:
    return np.asarray(fitted_series(t, x, like.period, len(like.coefficients) - 1)(t, 0)[0])


def _variance(t: Array, moved: Array, left: Array, period: float) -> float:
    """Return the variance of sum(moved * left) for noise of the spectrum of ``left``, at least that of white noise."""
    from scipy.fft import rfft

    periods = float(t[-1] - t[0]) / period
    noise = spectrum(left, max(LINES, round(periods))) * taken(periods)
    white = np.square(left).sum(axis=0)
    power = np.square(np.abs(rfft(moved, axis=0)))
    return 2.0 * float((power * np.maximum(noise, white)).sum()) / len(t) ** 2
