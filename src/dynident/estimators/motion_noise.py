"""What noise of the positions leaves in a smoothed motion, as far as the motion itself shows it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.log import Log, Motion
from dynident.splines import steady_noise

__all__ = ["MotionNoise", "motion_noise"]

Array = NDArray[np.float64]
WINDOW = 1024  # samples of a spectrum, at most
SHORTEST = 16
LEAST = 1e-7  # noise, relative to the largest position
TRIED = 300  # cut-offs


@dataclass(frozen=True, eq=False)
class MotionNoise:
    """The noise of a motion's positions and how far it passes: ``density`` (n) in rad^2/Hz or m^2/Hz, and the
    ``cutoff`` (n), in Hz, at which smoothing halves an amplitude."""

    density: Array
    cutoff: Array

    __repr__ = brief

    def drawn(self, motion: Motion, rng: np.random.Generator) -> Motion:
        """Return the motion with errors like its own added to q, dq and ddq.

        White noise of the positions is passed as by a smoothing spline, 1 / (1 + (f / cutoff)^4), and differentiated.
        """
        n, step = len(motion), float(np.diff(motion.t).mean())
        size = n + (n % 2)
        f = np.fft.rfftfreq(size, step)[:, None]
        white = np.fft.rfft(rng.standard_normal((size, len(self.density))), axis=0) * np.sqrt(self.density / (2 * step))
        passed = white / (1.0 + (f / self.cutoff) ** 4)
        rate = 2j * np.pi * f
        q, dq, ddq = (np.fft.irfft(passed * rate**k, size, axis=0)[:n] for k in range(3))
        return replace(motion, q=motion.q + q, dq=motion.dq + dq, ddq=motion.ddq + ddq)


def motion_noise(log: Log, motion: Motion, time_offset: float = 0.0) -> MotionNoise:
    """Return the noise of a log's positions, and how far it passes into its motion.

    The density is that of the positions' differences, which motion hardly has. How far smoothing passes is seen where
    measured and smoothed positions are compared: the cut-off is that of the spline whose transfer function is nearest.
    """
    step = float(np.diff(log.t).mean())
    if int(motion.mask.sum()) < SHORTEST:
        return MotionNoise(np.zeros(log.q.shape[1]), np.full(log.q.shape[1], 1e3 / step))
    smooth = motion.shifted(-time_offset).q if time_offset else motion.q
    cutoff = [_cutoff(a, b, step) for a, b in zip(log.q[motion.mask].T, smooth[motion.mask].T, strict=True)]
    return MotionNoise(2 * step * np.square(steady_noise(log.q, LEAST)), np.array(cutoff))


def _cutoff(measured: Array, smooth: Array, step: float) -> float:
    """Return the cut-off (Hz) of smoothing by what it does to second differences, where low frequencies do not leak."""
    length = min(WINDOW, max((len(measured) - 2) // 4, SHORTEST - 2))
    window = np.hanning(length + 2)[1:-1]
    parts = [
        np.lib.stride_tricks.sliding_window_view(np.diff(x, 2), length)[:: max(length // 2, 1)]
        for x in (measured, smooth)
    ]
    before, after = (np.fft.rfft(part * window) for part in parts)
    f = np.fft.rfftfreq(length, step)[1:]
    power = np.square(np.abs(before)).sum(axis=0)[1:]
    passed = (before.conj() * after).real.sum(axis=0)[1:]
    share = np.divide(passed, power, out=np.ones_like(power), where=power > 0)
    tried = np.append(np.geomspace(f[0], f[-1], TRIED), 1e3 / step)[:, None]
    return float(tried[np.square(share - 1.0 / (1.0 + (f / tried) ** 4)).sum(axis=1).argmin(), 0])
