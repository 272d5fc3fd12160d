"""Where a residual repeats with the position, some time later or earlier: the largest lines of its periodogram."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Residual", "peaks"]

Array = NDArray[np.float64]
Line = tuple[float, float]
LEAST, PERIODS = (
    4.0,
    4.0,
)  # 1/rad, rad/m, and periods within the reach: slower waves are springs, or errors of the bodies
MOST = 600.0  # 1/rad, rad/m
FINE = 4  # points of the periodogram per resolved rate
DELAYS = 1e-3 * np.arange(-12.0, 13.0, 2.0)  # s
NEAR, SOON = np.linspace(-0.3, 0.3, 7), 1e-3 * np.arange(-1.5, 1.6, 0.5)  # of a resolved rate; s: the search around
LINE, AROUND = 15.0, 30  # times the median of so many resolved rates around it, that a line must exceed
WITHIN = 2.0  # times that median: what a whole number of periods in a turn may lose


@dataclass(frozen=True, eq=False)
class Residual:
    """The residual ``r`` (N) of a joint that ``turns``, at its positions and velocities ``q``, ``dq`` (N), in
    ``blocks`` of time, ``block`` (N) that of each sample; samples of block -1 are left out."""

    q: Array
    dq: Array
    r: Array
    block: NDArray[np.intp]
    blocks: int
    turns: bool = True

    __repr__ = brief

    def powers(self, lines: list[Line]) -> Array:
        """Return |sum r exp(-i k (q - d dq))|^2 (F, L) of lines, rates k and delays d, without each block in turn."""
        use = self.block >= 0
        q, dq, r, block = self.q[use], self.dq[use], self.r[use], self.block[use]
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        sums = np.zeros((self.blocks, len(lines)), dtype=complex)
        for n, (k, d) in enumerate(lines):
            np.add.at(sums[:, n], block[starts], np.add.reduceat(r * np.exp(-1j * k * (q - d * dq)), starts))
        return np.asarray(np.square(np.abs(sums.sum(axis=0) - sums)))

    def spectra(self, d: float, most: float) -> tuple[Array, Array]:
        """Return rates (K) up to ``most``, and at each the power (F, K) of a line of delay d without each block."""
        use = self.block >= 0
        u = self.q[use] - d * self.dq[use]
        span = FINE * (float(np.ptp(self.q)) or 1.0)
        bins = int(2 ** np.ceil(np.log2(2.0 * span * most / np.pi)))
        at = ((u - u.min()) / span * bins).astype(int) % bins
        sums = np.bincount(self.block[use] * bins + at, self.r[use], self.blocks * bins).reshape(self.blocks, bins)
        rate = np.asarray(2.0 * np.pi * np.arange(bins // 2 + 1) / span, dtype=float)
        few = rate <= most
        spectra = np.fft.rfft(sums, axis=1)[:, few]
        power: Array = np.square(np.abs(spectra.sum(axis=0) - spectra))
        return rate[few], power


def peaks(one: Residual, fastest: float) -> tuple[Line, ...]:
    """Return rates k (1/rad, rad/m) and delays d (s) of the largest lines without each block in turn, so that a fold
    finds what its own training shows.

    A line must stand out of the rates around it: errors of the bodies and of friction are broad. No rate exceeds
    ``fastest``. That of a joint that turns is a whole number where one fits as well: the wave closes after a turn.
    """
    from scipy.ndimage import median_filter

    reach = float(np.ptp(one.q))
    least, most = max(LEAST, 2.0 * np.pi * PERIODS / max(reach, 1e-12)), min(MOST, fastest)
    if not reach or least >= most:
        return ()
    every = [one.spectra(d, most) for d in DELAYS.tolist()]
    rate, power = every[0][0], np.stack([spectra for _, spectra in every])  # (D, F, K)
    around = median_filter(power.mean(axis=(0, 1)), AROUND * FINE, mode="nearest")
    power *= (power > LINE * around) & (rate >= least)
    found: dict[Line, None] = {}
    flat = power.transpose(1, 0, 2).reshape(one.blocks, -1)
    for place in np.unique(np.argmax(flat, axis=1)[flat.any(axis=1)]).tolist():
        d, k = divmod(place, len(rate))
        found |= dict.fromkeys(_refined(one, (float(rate[k]), float(DELAYS[d])), reach, WITHIN * float(around[k])))
    return tuple(found)


def _refined(one: Residual, line: Line, reach: float, loss: float) -> list[Line]:
    """Return the best lines around one without each block in turn; whole rates that lose no more than ``loss``."""
    k, d = line
    rates = k + NEAR * 2.0 * np.pi / reach
    whole = np.unique(np.round(rates)) if one.turns else np.zeros(0)
    whole = whole[(whole >= rates[0]) & (whole <= rates[-1])]
    delays = d + SOON
    lines = [(x, y) for x in [*rates.tolist(), *whole.tolist()] for y in delays.tolist()]
    power = one.powers(lines)
    first = len(rates) * len(delays)
    best = np.argmax(power[:, :first], axis=1)
    if len(whole):
        other = first + np.argmax(power[:, first:], axis=1)
        every = np.arange(one.blocks)
        best = np.where(power[every, other] > power[every, best] - loss, other, best)
    return [lines[n] for n in np.unique(best).tolist()]
