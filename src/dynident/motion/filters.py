"""Recursive filters: Butterworth's low-pass, and their zero-phase use forward and backward; spectra and correlations.

By the kernel where there is one, many series side by side, else by SciPy, whose ``scipy.signal`` takes half a second to
import. Conventions are SciPy's: a filter is an array (k, 6) of second-order sections b0, b1, b2, 1, a1, a2.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dynident.runtime.arrays import Array
from dynident.runtime.kernel import function

MAX_KERNEL_SECTIONS = 8  # sections that the kernel takes
MAX_LAGS = 20  # of the whiteness test


def butterworth(order: int, cutoff: float, rate: float) -> Array:
    """Return the second-order sections of a Butterworth low-pass, ``cutoff`` and sampling ``rate`` in Hz.

    The bilinear transform of the analogue filter whose cut-off is warped. As SciPy does, the section nearest to the
    unit circle comes last, and the gain of all is in the first.
    """
    # prewarping: the bilinear transform maps this analogue cut-off to the digital one
    warped = 2.0 * np.tan(np.pi * cutoff / rate)
    angles = np.pi * np.arange(-order + 1, order, 2) / (2 * order)
    analogue = -warped * np.exp(1j * angles)
    poles = (2.0 + analogue) / (2.0 - analogue)
    gain = warped**order / np.prod(2.0 - analogue).real
    # pairs of conjugate poles, those nearest to the unit circle last, as in SciPy
    pairs = sorted(poles[poles.imag > 1e-12 * np.abs(poles)], key=abs)
    sections = [[1.0, 2.0, 1.0, 1.0, -2.0 * pole.real, abs(pole) ** 2] for pole in pairs]
    if order % 2:
        sections.insert(0, [1.0, 1.0, 0.0, 1.0, -poles[order // 2].real, 0.0])
    sos = np.array(sections)
    sos[0, :3] *= gain
    return sos


def zero_phase(sections: Array, x: ArrayLike, pad: int, axis: int = -1) -> Array:
    """Return x filtered forward and backward along an axis, extended by ``pad`` samples at both ends, oddly.

    It is ``scipy.signal.sosfiltfilt``, and fastest for series that are contiguous in memory.
    """
    run = _kernel()
    if run is None or len(sections) > MAX_KERNEL_SECTIONS:
        from scipy.signal import sosfiltfilt

        return np.asarray(sosfiltfilt(sections, x, axis=axis, padlen=pad))
    series = np.moveaxis(np.asarray(x, dtype=float), axis, -1)
    n = series.shape[-1]
    if pad >= n:
        raise ValueError(f"a series of {n} samples cannot be extended by {pad}")
    wide = np.empty((int(np.prod(series.shape[:-1])), n + 2 * pad))
    inner = wide[:, pad : pad + n]
    inner[:] = series.reshape(-1, n)
    # odd extension about the end points, which keeps value and slope
    wide[:, :pad] = 2 * inner[:, :1] - inner[:, pad:0:-1]
    wide[:, pad + n :] = 2 * inner[:, -1:] - inner[:, -2 : -pad - 2 : -1]
    steady = _steady_state(sections)
    # forward, then backward, each from the steady state of the first value, so that there is no transient
    for back, edge in ((0, 0), (1, -1)):
        state = steady * wide[:, edge, None, None]
        run(*wide.shape, wide.ctypes.data, len(sections), sections.ctypes.data, state.ctypes.data, back)
    return np.moveaxis(wide[:, pad : pad + n].reshape(series.shape), -1, axis)


def one_pole_filter(a: float, x: Array) -> Array:
    """Return y(k) = x(k) + a y(k - 1) along the last axis of x, from y = 0."""
    run = _kernel()
    if run is None:
        from scipy.signal import lfilter

        return np.asarray(lfilter([1.0], [1.0, -a], x))
    out = np.array(x, dtype=float, order="C").reshape(int(np.prod(x.shape[:-1])), x.shape[-1])
    section, state = np.array([1.0, 0.0, 0.0, 1.0, -a, 0.0]), np.zeros((len(out), 1, 2))
    run(*out.shape, out.ctypes.data, 1, section.ctypes.data, state.ctypes.data, 0)
    return out.reshape(x.shape)


def frequency_response(sections: Array, points: int) -> Array:
    """Return the frequency response at ``points`` frequencies from zero to below half of the sampling rate."""
    z = np.exp(-1j * np.pi * np.arange(points) / points)
    return np.asarray(
        np.prod([np.polyval(section[2::-1], z) / np.polyval(section[:2:-1], z) for section in sections], axis=0)
    )


def slowest_pole(sections: Array) -> float:
    """Return the largest absolute value of the poles."""
    return float(max(np.abs(np.roots(section[3:])).max(initial=0.0) for section in sections))


def welch(x: Array, step: float, length: int) -> tuple[Array, Array]:
    """Return frequencies (Hz) and power density of x (N), sampled at ``step`` (s), by Welch's method.

    Stretches of ``length`` overlap by half, less their mean and under Hann's window.
    """
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    parts = np.lib.stride_tricks.sliding_window_view(x, length)[:: length - length // 2]
    power = np.square(np.abs(np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window)))
    power *= step / np.square(window).sum()
    power[:, 1 : -1 if length % 2 == 0 else None] *= 2
    return np.asarray(np.fft.rfftfreq(length, step), dtype=np.float64), np.asarray(power.mean(axis=0))


def cross_correlation(x: Array, y: Array) -> Array:
    """Return sum_k x(k) y(k + lag) of series (N) and (M) at the lags -N + 1 to M - 1."""
    from scipy.fft import irfft, next_fast_len, rfft

    count = len(x) + len(y) - 1
    size = next_fast_len(count, real=True)
    return np.asarray(irfft(rfft(x[::-1], size) * rfft(y, size), size)[:count])


def autocorrelation(x: Array) -> Array:
    """Return the autocorrelation (N) of x (N) about its mean, by FFT; entry 0 is one.

    >>> autocorrelation(np.array([1.0, -1.0, 1.0, -1.0])).round(12).tolist()
    [1.0, -0.75, 0.5, -0.25]
    """
    from scipy.fft import irfft, next_fast_len, rfft

    centred = x - x.mean()
    size = next_fast_len(2 * len(x), real=True)
    correlation = np.asarray(irfft(np.abs(rfft(centred, size)) ** 2, size))[: len(x)]
    return np.asarray(correlation / correlation[0], dtype=np.float64)


def ljung_box(correlation: Array, samples: int) -> float:
    """Return the p-value of Q = N (N + 2) sum rho_k^2 / (N - k), chi-squared if white (Ljung and Box, 1978).

    >>> noise = np.random.default_rng(0).standard_normal(1000)
    >>> ljung_box(autocorrelation(noise), 1000)
    0.79
    >>> ljung_box(autocorrelation(np.cumsum(noise)), 1000)
    0.0
    """
    from scipy.special import chdtrc

    k = np.arange(1, min(MAX_LAGS, samples // 5) + 1)
    q = samples * (samples + 2) * float(np.sum(correlation[k] ** 2 / (samples - k)))
    return float(chdtrc(len(k), q))


def _steady_state(sections: Array) -> Array:
    """Return the state (k, 2) of each section after a constant input of one."""
    states, level = np.empty((len(sections), 2)), 1.0
    for state, (b0, b1, b2, _, a1, a2) in zip(states, sections, strict=True):
        out = level * (b0 + b1 + b2) / (1.0 + a1 + a2)
        state[1] = b2 * level - a2 * out
        state[0] = b1 * level - a1 * out + state[1]
        level = out
    return states


def _kernel() -> Callable[..., None] | None:
    integer, pointer = ctypes.c_int64, ctypes.c_void_p
    return function("sections", integer, integer, pointer, integer, pointer, pointer, integer)
