"""Instruments from the motion some time before and after each sample, where the noise is another.

The state at t is interpolated from those at t - lag and t + lag by the polynomial of degree five. Smoothing spreads the
noise of a position over its neighbours, a filter of the equations once more; the lag is longer than that. What must
hold: the noise of the positions itself is white, or not correlated over the lag.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.estimators.instrumental_variables.instruments import Instruments
from dynident.estimators.instrumental_variables.notes import InstrumentKind
from dynident.filters import response
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.regression import ParallelFilter

__all__ = ["cutoff", "lag_of", "lagged_instruments"]

Array = NDArray[np.float64]
LEAST = 3  # samples: central differences so far apart share none
FORGOTTEN = 0.01  # correlation of the errors of accelerations that counts as none
POINTS = 2**14  # of a spectrum
SEGMENTS, LONGEST, TAPER = 16, 2**10, 2  # of a spectrum; differences by which positions become nearly white: no leak
SMALL = 1e-6  # of the largest power: too little to say what passes there


def lagged_instruments(
    model: Model, motion: Motion, log: Log | None, low: ParallelFilter | None, lag: float | None
) -> Instruments:
    """Return the motion interpolated from a ``lag`` (s) before and after; None takes that of ``lag_of``.

    Raises ConfigError where it is shorter than the time between samples.
    """
    apart = lag_of(motion, log, low) if lag is None else lag
    step = float(np.diff(motion.t).mean())
    if not apart > 0.99 * step:
        raise ConfigError(
            f"lag = {apart} s of the instruments is shorter than the time between samples, {step:.3g} s; give a longer "
            "one, or null."
        )
    early, late = motion.shifted(-apart), motion.shifted(apart)
    mask = _usable(motion, -apart) & _usable(motion, apart)
    q, dq, ddq = _midway(early, late, 2 * apart)
    found = replace(motion, q=q, dq=dq, ddq=ddq, mask=mask, memory=None)
    return Instruments(model.remembering(found), InstrumentKind.LAGGED, apart)


def lag_of(motion: Motion, log: Log | None, low: ParallelFilter | None) -> float:
    """Return the time (s) from which on errors of the accelerations of a motion are not correlated.

    White noise passes the smoother and twice the zero-phase filter ``low``. The smoother's cut-off shows in the
    positions of log and motion, and its response is taken as that of a smoothing spline, 1 / (1 + (f / cut-off)^4).
    Without a log, positions count as measured.
    """
    step = float(np.diff(motion.t).mean())
    if log is None and low is None:
        return LEAST * step
    f = np.arange(POINTS) / POINTS  # of half of the sampling rate
    passed = f**4 / (1.0 + (f / (1.0 if log is None else cutoff(log.q, motion.q))) ** 4) ** 2
    if low is not None:
        passed *= np.abs(response(low.sections(motion), POINTS)) ** 4
    correlation = np.fft.irfft(passed)
    far = np.flatnonzero(np.abs(correlation[:POINTS]) > FORGOTTEN * correlation[0])
    return max(LEAST, int(far.max()) + 1) * step


def cutoff(before: Array, after: Array) -> float:
    """Return the frequency from which on less than half of some column (N, n) passes, in half of the sampling rate.

    It is also that from which on there is nothing left to pass, as after the low-pass of a recorder.
    """
    length = int(np.clip(2 ** int(np.log2(max(len(before) // SEGMENTS, 1))), 16, LONGEST))
    if len(before) < 2 * length:
        return 1.0
    found, window = 1.0, np.hanning(length)
    for columns in zip(before.T, after.T, strict=True):
        one, other = (_spectra(np.diff(x, TAPER), window) for x in columns)
        power = np.square(np.abs(one)).mean(axis=0)
        shown = power > SMALL * power.max()
        gain = np.abs((one.conj() * other).mean(axis=0)) / np.where(shown, power, np.inf)
        if shown.any():
            end = np.flatnonzero(shown)[-1] + 1
            lost = np.flatnonzero(shown & (gain < 0.5)).min(initial=end)
            found = min(found, max(int(lost), 1) / (len(gain) - 1))
    return found


def _spectra(x: Array, window: Array) -> Array:
    """Return the Fourier transforms (k, m) of overlapping stretches of x (N) under a window."""
    parts = np.lib.stride_tricks.sliding_window_view(x, len(window))[:: len(window) // 2]
    return np.asarray(np.fft.rfft(parts * window))


def _usable(motion: Motion, offset: float) -> NDArray[np.bool_]:
    """Whether the motion is usable at each sample and around the time ``offset`` (s) from it."""
    at = motion.t + offset
    k = np.clip(np.searchsorted(motion.t, at, side="right") - 1, 0, len(motion) - 2)
    inside = (at >= motion.t[0]) & (at <= motion.t[-1])
    return np.asarray(motion.mask & inside & motion.mask[k] & motion.mask[k + 1])


def _midway(a: Motion, b: Motion, T: float) -> tuple[Array, Array, Array]:
    """Return q, dq, ddq (N, n) in the middle of the polynomials of degree five between states that are T s apart."""
    q = (a.q + b.q) / 2 + (5 / 32) * T * (a.dq - b.dq) + T**2 / 64 * (a.ddq + b.ddq)
    dq = (15 / 8) * (b.q - a.q) / T - (7 / 16) * (a.dq + b.dq) + T / 32 * (b.ddq - a.ddq)
    return q, dq, 1.5 * (b.dq - a.dq) / T - (a.ddq + b.ddq) / 4
