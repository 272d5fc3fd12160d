"""Where a residual repeats with the position: the largest lines of its periodogram."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["near", "peaks"]

Array = NDArray[np.float64]
LEAST = 4.0  # 1/rad, rad/m, and twice the reach of the joint: slower waves are springs, or errors of the bodies
MOST = 2000.0  # 1/rad, rad/m
FINE = 4  # points of the periodogram per resolved rate
BETWEEN = 8  # rates that are tried between two points: an error of the rate is seen on positions further out
LINE, AROUND = 15.0, 30  # times the median of so many resolved rates around it, that a line must exceed


def peaks(q: Array, residual: Array, block: NDArray[np.intp], blocks: int, fastest: float) -> tuple[float, ...]:
    """Return the rates k (1/rad, rad/m) of the largest lines of |sum r exp(-i k q)|^2 without each block in turn, so
    that a fold finds what its own training shows.

    A line must stand out of the rates around it: errors of the bodies and of friction are broad. q and the residual r
    (N) are of one joint; samples of block -1 are left out. Rates that the reach of the motion cannot tell apart are
    listed once, and none exceeds ``fastest``.
    """
    from scipy.ndimage import median_filter

    reach = float(np.ptp(q))
    least, most = max(LEAST, 4.0 * np.pi / max(reach, 1e-12)), min(MOST, fastest)
    if not reach or least >= most:
        return ()
    span = FINE * reach
    bins = int(2 ** np.ceil(np.log2(2.0 * span * most / np.pi)))
    at = np.minimum(((q - q.min()) / span * bins).astype(int), bins - 1)
    sums = np.stack([np.bincount(at[block == f], residual[block == f], bins) for f in range(blocks)])
    spectra = np.fft.rfft(sums, axis=1)
    rate = 2.0 * np.pi * np.arange(spectra.shape[1]) / span
    power = np.square(np.abs(spectra.sum(axis=0) - spectra))
    around = median_filter(power.mean(axis=0), AROUND * FINE, mode="nearest")
    power *= (power > LINE * around) & (rate >= least) & (rate <= most)
    found: list[float] = []
    for k in rate[np.argmax(power, axis=1)][power.any(axis=1)].tolist():
        if all(abs(k - one) > np.pi / reach for one in found):
            found.append(float(k))
    return tuple(found)


def near(rates: tuple[float, ...], q: Array) -> tuple[float, ...]:
    """Return rates around each of those of ``peaks``, between the neighbouring points of the periodogram."""
    apart = 2.0 * np.pi / (FINE * max(float(np.ptp(q)), 1e-12))
    steps = np.arange(-BETWEEN + 1, BETWEEN) / BETWEEN * apart
    return tuple(float(k + step) for k in rates for step in (0.0, *steps[steps != 0.0]))
