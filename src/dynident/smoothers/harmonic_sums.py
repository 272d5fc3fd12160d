"""Sums over harmonics and over samples, and the normal equations of both: by FFT where samples are evenly spaced.

With e(t) = exp(2 pi i (t - middle) / period) and evenly spaced samples about the middle, the sums are chirp transforms
(Bluestein, 1970), and the equations of cosines and of sines are apart. Columns are in the order of the harmonics: the
Cholesky factor of the equations of fewer harmonics is its leading block, so that all joints share one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Factor", "factor_of", "factorised", "products", "values"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
ROWS = 2048  # summed at once
SINGULAR = 1e-5  # times the largest pivot
PHASE = 1e-9  # rad of the highest harmonic by which evenly spaced samples may be off
KEPT = 4  # factors: logs are smoothed in turns


@dataclass(frozen=True, eq=False)
class Factor:
    """The lower Cholesky factors of the equations: of cosines and of sines, or of both in turns."""

    cosines: Array
    sines: Array | None

    __repr__ = brief

    def solve(self, right: Complex, harmonics: NDArray[np.intp]) -> Complex:
        """Return coefficients c (H + 1, k) for the ``products`` of samples (H + 1, k), those of column j up to its
        ``harmonics``."""
        found = np.zeros(right.shape, dtype=np.complex128)
        if self.sines is not None:
            found += _solved(self.cosines, right.real, harmonics + 1)
            found[1:] += 1j * _solved(self.sines, right.imag[1:], harmonics)
            return found
        both = np.stack([right.real, right.imag], axis=1).reshape(2 * len(right), -1)
        both = _solved(self.cosines, np.delete(both, 1, axis=0), 2 * harmonics + 1)
        found += np.concatenate([both[:1], both[1::2]])
        found[1:] += 1j * both[2::2]
        return found


def _solved(factor: Array, right: Array, size: NDArray[np.intp]) -> Array:
    """Return the solution of the leading block of each ``size``: beyond, zeros stay zeros in the second sweep."""
    from scipy.linalg import solve_triangular

    half = solve_triangular(factor, right, lower=True, check_finite=False)
    half[np.arange(len(half))[:, None] >= size] = 0.0
    return np.asarray(solve_triangular(factor, half, lower=True, trans=1, overwrite_b=True, check_finite=False))


def factor_of(t: Array, period: float, harmonics: int) -> Factor:
    """Return the factor for samples at times t (N), about their middle; LinAlgError where they do not determine it.

    Those of the last few times, periods and numbers are kept.
    """
    step = _step(t, period, 2 * harmonics + 1)
    even = None if step is None else (len(t), 2.0 * np.pi * step / period)
    return factorised(even, None if even else t.tobytes(), period if not even else 0.0, harmonics)


@lru_cache(maxsize=KEPT)
def factorised(even: tuple[int, float] | None, times: bytes | None, period: float, harmonics: int) -> Factor:
    """Return the factor for so many even samples of an angle each, else for the bytes of times."""
    count = harmonics + 1
    if even is not None:
        sums = _even_sums(*even, 2 * count - 1).astype(complex)
    else:
        t = np.frombuffer(times or b"")
        sums = products(t, np.ones((len(t), 1)), period, (t[0] + t[-1]) / 2, 2 * count - 1)[:, 0].conj()
    order = np.arange(count)
    apart, total = order[:, None] - order, order[:, None] + order
    less, more = sums[np.abs(apart)].real, sums[total].real
    cosines, sines = (less + more) / 2, (less - more)[1:, 1:] / 2
    if even is not None:
        return Factor(_cholesky(cosines), _cholesky(sines))
    mixed = (sums[total].imag - np.sign(apart) * sums[np.abs(apart)].imag) / 2  # cos of rows, sin of columns
    both = np.empty((2 * count, 2 * count))
    both[::2, ::2], both[2:, 2:][1::2, 1::2], both[::2, 1::2], both[1::2, ::2] = cosines, sines, mixed, mixed.T
    return Factor(_cholesky(np.delete(np.delete(both, 1, axis=0), 1, axis=1)), None)


def _cholesky(gram: Array) -> Array:
    from scipy.linalg import cholesky

    if not len(gram):
        return gram
    factor = np.asarray(cholesky(gram, lower=True, overwrite_a=True, check_finite=False))
    pivots = np.diag(factor)
    if not pivots.min() >= SINGULAR * pivots.max():
        raise np.linalg.LinAlgError("the samples do not determine the series")
    return factor


def _even_sums(samples: int, angle: float, count: int) -> Array:
    """Return the sums of cos(m x) over even samples about the middle, for m below ``count``: Dirichlet's kernel."""
    half = angle * np.arange(count) / 2
    below = np.sin(half)
    whole = np.abs(below) < 1e-12
    ratio = np.sin(samples * half) / np.where(whole, 1.0, below)
    return np.asarray(np.where(whole, samples * np.cos(samples * half) / np.cos(half), ratio))


def _step(t: Array, period: float, count: int) -> float | None:
    """Return the step of evenly spaced times, None where they are not for so many harmonics."""
    if len(t) < 2:
        return None
    step = float(t[-1] - t[0]) / (len(t) - 1)
    off = np.abs(t - t[0] - step * np.arange(len(t))).max()
    rounding = 4 * np.finfo(float).eps * max(abs(t[0]), abs(t[-1]))
    return step if off <= max(PHASE * period / (2 * np.pi * count), rounding) else None


def values(t: Array, c: Complex, period: float, middle: float) -> Array:
    """Return the real part of sum_k c_k e^k (N, n) at times t (N), for c (H + 1, n)."""
    turn, step, out = 2j * np.pi / period, _step(t, period, len(c)), np.empty((len(t), c.shape[1]))
    order = turn * np.arange(len(c))[:, None]
    for start in range(0, len(t), ROWS):
        at = t[start : start + ROWS] - middle
        if step is None:
            out[start : start + ROWS] = (_powers(np.exp(turn * at), len(c)) @ c).real
        else:
            first = t[0] - middle + step * start
            out[start : start + ROWS] = _chirp(c * np.exp(order * first), (turn * step).imag, len(at)).real
    return out


def products(t: Array, x: Array, period: float, middle: float, count: int) -> Complex:
    """Return the sums of conj(e^k) x (count, n) over samples x (N, n) at times t (N)."""
    turn, step, out = 2j * np.pi / period, _step(t, period, count), np.zeros((count, x.shape[1]), dtype=complex)
    order = turn * np.arange(count)[:, None]
    for start in range(0, len(t), ROWS):
        at, part = t[start : start + ROWS] - middle, x[start : start + ROWS]
        if step is None:
            out += _powers(np.exp(-turn * at), count).T @ part
        else:
            first = t[0] - middle + step * start
            out += np.exp(-order * first) * _chirp(part, -(turn * step).imag, count)
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
    half = np.exp(0.5j * angle * np.square(np.arange(max(rows, count), dtype=float)))
    size = next_fast_len(rows + count - 1)
    kernel = np.zeros(size, dtype=complex)
    kernel[:count] = half[:count].conj()
    kernel[size - rows + 1 :] = half[rows - 1 : 0 : -1].conj()
    found = ifft(fft(x.T * half[:rows], size) * fft(kernel))[:, :count]
    return np.asarray((found * half[:count]).T)
