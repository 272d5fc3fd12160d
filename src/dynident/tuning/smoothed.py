"""One joint of one log as it is smoothed, to be looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.filters import autocorrelation, welch
from dynident.log import Log, Motion
from dynident.splines import NORMAL_95, stretches

__all__ = ["Smoothed", "degree_of", "smoothed"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FLOOR = -6.0  # log10(S/n) of a spline through the data
LAGS = 400  # of the autocorrelation, at most
BINS = 600  # frequencies of a spectrum, at most
FEWEST = 8  # samples of a residual that is looked at


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The motion of a ``joint`` in a ``log``: ``measured`` and smoothed position ``q`` (N) at ``t`` (N) with
    derivatives ``dq`` and ``ddq``, in rad or m, and seconds.

    ``mask`` (N) is where derivatives of this joint are reliable and not excluded; a fit uses the samples at which
    those of all are. The ``residual`` (N) is measured less smoothed
    position, outliers replaced as in the fit, which ``outlier`` (N) marks. ``degree`` is log10(S/n) as reached, in
    terms of the ``noise`` (rad, m); ``cutoff`` (Hz) and ``edf``, effective degrees of freedom, are nan of another
    smoother than the spline.
    """

    log: str
    joint: str
    t: Array
    measured: Array
    q: Array
    dq: Array
    ddq: Array
    residual: Array
    outlier: Mask
    mask: Mask
    noise: float
    degree: float
    cutoff: float
    edf: float

    __repr__ = brief

    def spectrum(self) -> tuple[Array, Array]:
        """Return frequencies (Hz, F) and the power spectral density (F; rad^2/Hz, m^2/Hz) of the residual.

        White noise is flat; what smoothing took of the motion rises towards low frequencies, up to the cut-off. It is
        Welch's average over windows that overlap by half, in the longest stretch of usable samples.
        """
        x, step = self._stretch(), float(np.diff(self.t).mean())
        if len(x) < FEWEST:
            return np.zeros(0), np.zeros(0)
        f, power = welch(x, step, min(2 * BINS, len(x)))
        return f[1:], power[1:]

    def autocorrelation(self) -> tuple[Array, Array, float]:
        """Return lags (s, L), the autocorrelation (L) of the residual, and the size that 95 % of those of white noise
        stay below, in the longest stretch of usable samples."""
        x, step = self._stretch(), float(np.diff(self.t).mean())
        if len(x) < FEWEST or not np.ptp(x) > 0:
            return np.zeros(0), np.zeros(0), float("nan")
        lags = np.arange(1, min(LAGS, len(x) // 2) + 1)
        return np.asarray(step * lags, dtype=float), autocorrelation(x)[lags], NORMAL_95 / float(np.sqrt(len(x)))

    def _stretch(self) -> Array:
        parts = stretches(self.mask)
        return self.residual[max(parts, key=lambda one: one.stop - one.start)] if parts else np.zeros(0)


def degree_of(residual: Array, noise: float) -> float:
    """Return log10(S/n) of what smoothing left (N), for noise of this size."""
    ratio = float(np.mean(np.square(residual))) / noise**2 if noise > 0 else 0.0
    return max(float(np.log10(ratio)), FLOOR) if ratio > 0 else FLOOR


def smoothed(recorded: Log, repaired: Log, motion: Motion, joint: str, noise: float) -> Smoothed:
    """Return a joint of a log as recorded and as repaired, with its motion (and maybe that of others), not shifted in
    time."""
    j, k = motion.joints.index(joint), recorded.joints.index(joint)
    measured, q, clean = recorded.q[:, k], motion.q[:, j], repaired.q[:, k]
    residual = clean - q

    def of(name: str) -> float:
        return float(motion.smoothing[name][j]) if name in motion.smoothing else float("nan")

    return Smoothed(
        motion.source,
        joint,
        motion.t,
        measured,
        q,
        motion.dq[:, j],
        motion.ddq[:, j],
        residual,
        measured != clean,
        motion.mask,
        noise,
        degree_of(residual, noise),
        of("cutoff"),
        of("edf"),
    )
