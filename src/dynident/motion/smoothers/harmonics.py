"""Series of harmonics by least squares, at the times as they are, and what noise each of them holds.

With e(t) = exp(2 pi i (t - middle) / period), the series is the real part of sum_k c_k e^k. Its normal equations hold
the sums of e^m over the samples: over whole periods of equally spaced samples they are diagonal, and the series is that
of the average period.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dynident.runtime import Noun
from dynident.runtime.arrays import Array

Complex = NDArray[np.complex128]
BLOCK_ROWS = 2048  # summed at once
MIN_PIVOT_RATIO = 1e-5  # times the largest pivot
MAX_PHASE_ERROR = 1e-9  # rad of the highest harmonic by which evenly spaced samples may be off
CACHED_FACTORS = 4  # factors: logs are smoothed in turns


class Factor(Noun):
    """The lower Cholesky factors of the equations: of cosines and of sines, or of both in turns."""

    cosines: Array
    sines: Array | None

    def solve(self, right: Complex, harmonics: NDArray[np.intp]) -> Complex:
        """Return coefficients c (H + 1, k) for the ``sample_products`` of samples (H + 1, k).

        Those of column j reach up to its ``harmonics``; the others are zero.
        """
        coefficients = np.zeros(right.shape, dtype=np.complex128)
        # for evenly spaced samples about their middle, cosines and sines do not couple
        if self.sines is not None:
            coefficients += _solve_leading(self.cosines, right.real, harmonics + 1)
            coefficients[1:] += 1j * _solve_leading(self.sines, right.imag[1:], harmonics)
            return coefficients
        interleaved = np.stack([right.real, right.imag], axis=1).reshape(2 * len(right), -1)
        interleaved = _solve_leading(self.cosines, np.delete(interleaved, 1, axis=0), 2 * harmonics + 1)
        coefficients += np.concatenate([interleaved[:1], interleaved[1::2]])
        coefficients[1:] += 1j * interleaved[2::2]
        return coefficients


def _solve_leading(factor: Array, right: Array, size: NDArray[np.intp]) -> Array:
    """Return the solution of the leading block of each ``size``; entries beyond it are zero."""
    from scipy.linalg import solve_triangular

    half = solve_triangular(factor, right, lower=True, check_finite=False)
    # rows beyond the block are zeroed after the forward sweep; the backward sweep keeps them zero
    half[np.arange(len(half))[:, None] >= size] = 0.0
    return np.asarray(solve_triangular(factor, half, lower=True, trans=1, overwrite_b=True, check_finite=False))


def factor_of(t: Array, period: float, harmonics: int) -> Factor:
    """Return the factor for samples at times t (N), about their middle; LinAlgError where they do not determine it.

    Those of the last few times, periods and numbers are kept.
    """
    step = _even_step(t, period, 2 * harmonics + 1)
    even = None if step is None else (len(t), 2.0 * np.pi * step / period)
    return cached_factor(even, None if even else t.tobytes(), period if not even else 0.0, harmonics)


@lru_cache(maxsize=CACHED_FACTORS)
def cached_factor(even: tuple[int, float] | None, times: bytes | None, period: float, harmonics: int) -> Factor:
    """Return the factor for evenly spaced samples, or for arbitrary times.

    ``even`` is the number of even samples and the angle of a step; otherwise ``times`` holds the bytes of the
    times.
    """
    count = harmonics + 1
    if even is not None:
        sums = _even_sums(*even, 2 * count - 1).astype(complex)
    else:
        t = np.frombuffer(times or b"")
        sums = sample_products(t, np.ones((len(t), 1)), period, (t[0] + t[-1]) / 2, 2 * count - 1)[:, 0].conj()
    # 2 cos a cos b = cos(a - b) + cos(a + b), and likewise for sines: sums over harmonics give the Gram matrix
    order = np.arange(count)
    difference, total = order[:, None] - order, order[:, None] + order
    difference_sums, total_sums = sums[np.abs(difference)].real, sums[total].real
    cosines, sines = (difference_sums + total_sums) / 2, (difference_sums - total_sums)[1:, 1:] / 2
    if even is not None:
        return Factor(_cholesky(cosines), _cholesky(sines))
    mixed = (sums[total].imag - np.sign(difference) * sums[np.abs(difference)].imag) / 2  # cos of rows, sin of columns
    gram = np.empty((2 * count, 2 * count))
    gram[::2, ::2], gram[2:, 2:][1::2, 1::2], gram[::2, 1::2], gram[1::2, ::2] = cosines, sines, mixed, mixed.T
    return Factor(_cholesky(np.delete(np.delete(gram, 1, axis=0), 1, axis=1)), None)


def _cholesky(gram: Array) -> Array:
    from scipy.linalg import cholesky

    if not len(gram):
        return gram
    factor = np.asarray(cholesky(gram, lower=True, overwrite_a=True, check_finite=False))
    pivots = np.diag(factor)
    if not pivots.min() >= MIN_PIVOT_RATIO * pivots.max():
        raise np.linalg.LinAlgError("the samples do not determine the series")
    return factor


def _even_sums(samples: int, angle: float, count: int) -> Array:
    """Return the sums of cos(m x) over even samples about the middle, for m below ``count``: Dirichlet's kernel."""
    half = angle * np.arange(count) / 2
    # Dirichlet's kernel has a removable singularity at multiples of pi
    below = np.sin(half)
    is_multiple = np.abs(below) < 1e-12
    ratio = np.sin(samples * half) / np.where(is_multiple, 1.0, below)
    return np.asarray(np.where(is_multiple, samples * np.cos(samples * half) / np.cos(half), ratio))


def _even_step(t: Array, period: float, count: int) -> float | None:
    """Return the step of evenly spaced times, None where they are not for so many harmonics."""
    if len(t) < 2:
        return None
    step = float(t[-1] - t[0]) / (len(t) - 1)
    off = np.abs(t - t[0] - step * np.arange(len(t))).max()
    rounding = 4 * np.finfo(float).eps * max(abs(t[0]), abs(t[-1]))
    return step if off <= max(MAX_PHASE_ERROR * period / (2 * np.pi * count), rounding) else None


def series_values(t: Array, c: Complex, period: float, middle: float) -> Array:
    """Return the real part of sum_k c_k e^k (N, n) at times t (N), for c (H + 1, n)."""
    turn, step, out = 2j * np.pi / period, _even_step(t, period, len(c)), np.empty((len(t), c.shape[1]))
    order = turn * np.arange(len(c))[:, None]
    # in blocks, so that memory does not grow with the samples, nor rounding of the phase with time
    for start in range(0, len(t), BLOCK_ROWS):
        at = t[start : start + BLOCK_ROWS] - middle
        if step is None:
            out[start : start + BLOCK_ROWS] = (_powers(np.exp(turn * at), len(c)) @ c).real
        else:
            start_time = t[0] - middle + step * start
            out[start : start + BLOCK_ROWS] = _chirp(c * np.exp(order * start_time), (turn * step).imag, len(at)).real
    return out


def sample_products(t: Array, x: Array, period: float, middle: float, count: int) -> Complex:
    """Return the sums of conj(e^k) x (count, n) over samples x (N, n) at times t (N)."""
    turn, step, out = 2j * np.pi / period, _even_step(t, period, count), np.zeros((count, x.shape[1]), dtype=complex)
    order = turn * np.arange(count)[:, None]
    for start in range(0, len(t), BLOCK_ROWS):
        at, part = t[start : start + BLOCK_ROWS] - middle, x[start : start + BLOCK_ROWS]
        if step is None:
            out += _powers(np.exp(-turn * at), count).T @ part
        else:
            start_time = t[0] - middle + step * start
            out += np.exp(-order * start_time) * _chirp(part, -(turn * step).imag, count)
    return out


def _powers(step: Complex, count: int) -> Complex:
    """Return step^k for k below ``count`` (N, count)."""
    out = np.empty((len(step), count), dtype=np.complex128)
    out[:, 0] = 1.0
    for k in range(1, count):
        np.multiply(out[:, k - 1], step, out=out[:, k])
    return out


def _chirp(x: Complex | Array, angle: float, count: int) -> Complex:
    """Return the sums of x_n exp(i angle n m) (count, k) over the rows n of x, for m below ``count``.

    As 2 n m = n^2 + m^2 - (m - n)^2, they are a convolution.
    """
    from scipy.fft import fft, ifft, next_fast_len

    rows = len(x)
    # Bluestein: chirps before and after make the sums a convolution, of any length that is fast for the FFT
    half = np.exp(0.5j * angle * np.square(np.arange(max(rows, count), dtype=float)))
    size = next_fast_len(rows + count - 1)
    kernel = np.zeros(size, dtype=complex)
    kernel[:count] = half[:count].conj()
    kernel[size - rows + 1 :] = half[rows - 1 : 0 : -1].conj()
    product = ifft(fft(x.T * half[:rows], size) * fft(kernel))[:, :count]
    return np.asarray((product * half[:count]).T)


MIN_LINES = 8  # of the spectrum from which the noise at a harmonic is taken, at least
MIN_LINE_RATIO = 2.0  # times what the largest of all lines of white noise is of their mean
TINY = 1e-300


class HarmonicSeries(Noun):
    """The coefficients c (H + 1, k) of series of one ``period`` (s) about the time ``middle`` (s)."""

    period: float
    middle: float
    coefficients: Complex

    def __call__(self, t: Array, highest: int = 2) -> Array:
        """Return the values and derivatives up to the ``highest`` (highest + 1, N, k) at times t (N), s."""
        count, k = self.coefficients.shape
        turn = 2j * np.pi / self.period * np.arange(count)[:, None]
        stacked = np.concatenate([self.coefficients * turn**power for power in range(highest + 1)], axis=1)
        out = series_values(t, stacked, self.period, self.middle)
        return np.ascontiguousarray(out.reshape(len(t), highest + 1, k).transpose(1, 0, 2))


def fit_series(t: Array, q: Array, period: float, harmonics: int | NDArray[np.intp]) -> HarmonicSeries:
    """Return the least-squares series of q (N, k) with so many harmonics, one number or by column (k).

    Raises LinAlgError where the samples do not determine it.
    """
    counts = np.broadcast_to(np.asarray(harmonics, dtype=np.intp), q.shape[1])
    highest, middle, base = int(counts.max()), float(t[0] + t[-1]) / 2, q.mean(axis=0)
    factor = factor_of(t, period, highest)
    # the mean is subtracted first, so that no digits are lost to a large offset
    coefficients = factor.solve(sample_products(t, q - base, period, middle, highest + 1).conj(), counts).conj()
    coefficients[0] += base
    return HarmonicSeries(period, middle, coefficients)


def spectrum(x: Array, lines: int) -> Array:
    """Return the power of x (N, k), averaged over about ``lines`` neighbouring lines, (N // 2 + 1, k).

    For white noise it is N times the variance.
    """
    from scipy.fft import rfft
    from scipy.ndimage import uniform_filter1d

    power = np.square(np.abs(rfft(x, axis=0)))
    return np.asarray(uniform_filter1d(power, min(max(lines, 1), len(power)), axis=0, mode="mirror"))


def periods_in(t: Array, period: float) -> float:
    """Return how many periods samples at times t (N) last."""
    return float(t[-1] - t[0]) / period * len(t) / (len(t) - 1)


def noise_power(t: Array, residual: Array, period: float, harmonics: int) -> Array:
    """Return the mean |c_k|^2 (harmonics + 1, k) that noise gives to the harmonics, from the ``residual`` (N, k).

    Between its harmonics, a motion that repeats has nothing but noise.
    """
    count, periods = len(t), periods_in(t, period)
    lines = max(MIN_LINES, round(periods))
    power = spectrum(residual, lines)
    at = np.minimum(np.round(np.arange(harmonics + 1) * periods).astype(int), len(power) - 1)
    return np.asarray(4.0 / count**2 * power[at] * noise_correction(periods))


def highest_harmonic(t: Array, residual: Array, period: float, limit: int, floor: Array | float = TINY) -> int:
    """Return the highest harmonic, up to a ``limit``, whose line in the ``residual`` (N, k) stands out; 0 for none.

    It must stand out from the lines around it and from a ``floor`` of the mean |c|^2 (k).
    """
    from scipy.fft import rfft
    from scipy.ndimage import median_filter

    count, periods = len(t), periods_in(t, period)
    power = np.square(np.abs(rfft(residual - residual.mean(axis=0), axis=0)))
    # the median of exponentially distributed power is log 2 times its mean
    background = median_filter(power, (8 * MIN_LINES + 1, 1), mode="mirror") / np.log(2.0)
    at = np.minimum(np.round(np.arange(1, limit + 1) * periods).astype(int), len(power) - 1)
    level = MIN_LINE_RATIO * np.log(count) * np.maximum(background[at], floor * count**2 / 4)
    return int(np.flatnonzero((power[at] > level).any(axis=1)).max(initial=-1)) + 1


def noise_correction(periods: float) -> float:
    """Return the noise power over that of the residual near a harmonic: the fit takes one line of so many periods."""
    return periods / max(periods - 1.0, 0.5)


def choose_by_bic(series: HarmonicSeries, noise: Array, samples: int) -> NDArray[np.intp]:
    """Return the number of harmonics (k) of least Bayesian information criterion, for ``noise`` of each of them.

    A harmonic of noise alone lowers twice the log-likelihood by |c|^2 / (its mean / 2), two degrees of freedom.
    """
    gain = 2.0 * np.square(np.abs(series.coefficients[1:])) / np.maximum(noise[1:], TINY) - 2.0 * np.log(samples)
    total = np.concatenate([np.zeros_like(gain[:1]), np.cumsum(gain, axis=0)])
    return np.asarray(np.argmax(total, axis=0))
