"""Series of harmonics by least squares, at the times as they are, and what noise each of them holds.

With e(t) = exp(2 pi i (t - middle) / period), the series is the real part of sum_k c_k e^k. Its normal equations hold
the sums of e^m over the samples: over whole periods of equally spaced samples they are diagonal, and the series is that
of the average period.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.smoothers.harmonic_sums import factor_of, products, values

__all__ = ["HarmonicSeries", "by_bic", "fitted_series", "highest_seen", "noise_power", "spectrum", "taken"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
LINES = 8  # of the spectrum from which the noise at a harmonic is taken, at least
STANDS_OUT = 2.0  # times what the largest of all lines of white noise is of their mean
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class HarmonicSeries:
    """The coefficients c (H + 1, k) of series of one ``period`` (s) about the time ``middle`` (s)."""

    period: float
    middle: float
    coefficients: Complex

    __repr__ = brief

    def __call__(self, t: Array, highest: int = 2) -> Array:
        """Return the values and derivatives up to the ``highest`` (highest + 1, N, k) at times t (N), s."""
        count, k = self.coefficients.shape
        turn = 2j * np.pi / self.period * np.arange(count)[:, None]
        stacked = np.concatenate([self.coefficients * turn**power for power in range(highest + 1)], axis=1)
        out = values(t, stacked, self.period, self.middle)
        return np.ascontiguousarray(out.reshape(len(t), highest + 1, k).transpose(1, 0, 2))


def fitted_series(t: Array, q: Array, period: float, harmonics: int | NDArray[np.intp]) -> HarmonicSeries:
    """Return the series of q (N, k) by least squares, of so many harmonics, one number or by column (k); LinAlgError
    where the samples do not determine it."""
    each = np.broadcast_to(np.asarray(harmonics, dtype=np.intp), q.shape[1])
    most, middle, base = int(each.max()), float(t[0] + t[-1]) / 2, q.mean(axis=0)
    factor = factor_of(t, period, most)
    found = factor.solve(products(t, q - base, period, middle, most + 1).conj(), each).conj()
    found[0] += base
    return HarmonicSeries(period, middle, found)


def spectrum(x: Array, lines: int) -> Array:
    """Return the power of x (N, k), as N times the variance of white noise, averaged over about so many neighbouring
    lines (N // 2 + 1, k)."""
    from scipy.fft import rfft
    from scipy.ndimage import uniform_filter1d

    power = np.square(np.abs(rfft(x, axis=0)))
    return np.asarray(uniform_filter1d(power, min(max(lines, 1), len(power)), axis=0, mode="mirror"))


def noise_power(t: Array, left: Array, period: float, harmonics: int) -> Array:
    """Return the mean |c_k|^2 (harmonics + 1, k) that noise gives to the harmonics, from what is ``left`` (N, k)
    between them.

    Between its harmonics a motion that repeats has nothing but noise.
    """
    count = len(t)
    periods = (t[-1] - t[0]) / period * count / (count - 1)
    lines = max(LINES, round(periods))
    power = spectrum(left, lines)
    at = np.minimum(np.round(np.arange(harmonics + 1) * periods).astype(int), len(power) - 1)
    return np.asarray(4.0 / count**2 * power[at] * taken(periods))


def highest_seen(t: Array, left: Array, period: float, limit: int, floor: Array | float = TINY) -> int:
    """Return the highest harmonic, up to a ``limit``, whose line stands out of its neighbours in what is ``left`` (N,
    k), and of a ``floor`` of the mean |c|^2 (k); 0 where none does."""
    from scipy.fft import rfft
    from scipy.ndimage import median_filter

    count = len(t)
    periods = (t[-1] - t[0]) / period * count / (count - 1)
    power = np.square(np.abs(rfft(left - left.mean(axis=0), axis=0)))
    usual = median_filter(power, (8 * LINES + 1, 1), mode="mirror") / np.log(2.0)
    at = np.minimum(np.round(np.arange(1, limit + 1) * periods).astype(int), len(power) - 1)
    seen = (power[at] > STANDS_OUT * np.log(count) * np.maximum(usual[at], floor * count**2 / 4)).any(axis=1)
    return int(np.flatnonzero(seen).max(initial=-1)) + 1


def taken(periods: float) -> float:
    """Return how much more noise there is than a fit has left near its harmonics: it takes one line of so many."""
    return periods / max(periods - 1.0, 0.5)


def by_bic(series: HarmonicSeries, noise: Array, samples: int) -> NDArray[np.intp]:
    """Return the number of harmonics (k) of least Bayesian information criterion, for ``noise`` of each of them.

    A harmonic of noise alone lowers twice the log-likelihood by |c|^2 / (its mean / 2), two degrees of freedom.
    """
    gain = 2.0 * np.square(np.abs(series.coefficients[1:])) / np.maximum(noise[1:], TINY) - 2.0 * np.log(samples)
    total = np.concatenate([np.zeros_like(gain[:1]), np.cumsum(gain, axis=0)])
    return np.asarray(np.argmax(total, axis=0))
