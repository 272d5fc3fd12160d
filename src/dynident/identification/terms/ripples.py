"""Ripples of a joint, sought at the lines in its residual by position."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dynident.identification.terms.candidates import CandidateKind, JointExcitation, fixed_terms
from dynident.identification.terms.samples import TermSamples
from dynident.models.friction import LoadRipple, Ripple
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

RIPPLES = {"ripple": Ripple, "load_ripple": LoadRipple}
Line = tuple[float, float]
# 1/rad, rad/m, and periods within the reach: slower waves are springs, or errors of the bodies
MIN_RATE, MIN_PERIODS = 4.0, 4.0
MAX_TURN_RATE, MAX_SLIDE_RATE = 600.0, 1600.0  # 1/rad; rad/m, as of a screw with a pitch of 4 mm
POINTS_PER_RATE = 4  # points of the periodogram per resolved rate
DELAYS = 1e-3 * np.arange(-12.0, 13.0, 2.0)  # s
# of a resolved rate; s: the search around
RATE_OFFSETS, DELAY_OFFSETS = (np.linspace(-0.3, 0.3, 7), 1e-3 * np.arange(-1.5, 1.6, 0.5))
MIN_LINE_RATIO, MEDIAN_WIDTH = 15.0, 30  # times the median of so many resolved rates around it, that a line must exceed
MAX_WHOLE_RATE_LOSS = 2.0  # times that median: what a whole number of periods in a turn may lose


class PositionResidual(Noun):
    """The residual ``r`` (N) of a joint at its positions and velocities ``q``, ``dq`` (N).

    ``block`` (N) is the block of time of each sample, of which there are ``blocks``; samples of block -1 are left
    out. ``turns`` tells whether the joint is revolute.
    """

    q: Array
    dq: Array
    r: Array
    block: NDArray[np.intp]
    blocks: int
    turns: bool = True

    def powers(self, lines: list[Line]) -> Array:
        """Return |sum r exp(-i k (q - d dq))|^2 (F, L) of lines with rates k and delays d, without each block."""
        use = self.block >= 0
        q, dq, r, block = self.q[use], self.dq[use], self.r[use], self.block[use]
        # Sums by block, so that leaving one out is a subtraction.
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        sums = np.zeros((self.blocks, len(lines)), dtype=complex)
        for n, (k, d) in enumerate(lines):
            np.add.at(sums[:, n], block[starts], np.add.reduceat(r * np.exp(-1j * k * (q - d * dq)), starts))
        return np.asarray(np.square(np.abs(sums.sum(axis=0) - sums)))

    def spectra(self, d: float, max_rate: float) -> tuple[Array, Array]:
        """Return rates (K) up to ``max_rate``, and the power (F, K) of a line of delay d, without each block."""
        use = self.block >= 0
        u = self.q[use] - d * self.dq[use]
        span = POINTS_PER_RATE * (float(np.ptp(self.q)) or 1.0)
        # Positions are binned for an FFT, with enough bins that the largest rate is well below their Nyquist rate.
        bins = int(2 ** np.ceil(np.log2(2.0 * span * max_rate / np.pi)))
        at = ((u - u.min()) / span * bins).astype(int) % bins
        sums = np.bincount(self.block[use] * bins + at, self.r[use], self.blocks * bins).reshape(self.blocks, bins)
        rate = np.asarray(2.0 * np.pi * np.arange(bins // 2 + 1) / span, dtype=float)
        in_range = rate <= max_rate
        spectra = np.fft.rfft(sums, axis=1)[:, in_range]
        power: Array = np.square(np.abs(spectra.sum(axis=0) - spectra))
        return rate[in_range], power


def largest_lines(residual: PositionResidual, fastest: float) -> tuple[Line, ...]:
    """Return rates k (1/rad, rad/m) and delays d (s) of the largest lines, leaving out each block in turn.

    So a fold finds what its own training shows. A line must stand out of the rates around it: errors of the
    bodies and of friction are broad. No rate exceeds ``fastest``. That of a revolute joint is a whole number
    where one fits as well: the wave closes after a turn.
    """
    from scipy.ndimage import median_filter

    reach = float(np.ptp(residual.q))
    min_rate = max(MIN_RATE, 2.0 * np.pi * MIN_PERIODS / max(reach, 1e-12))
    max_rate = min(MAX_TURN_RATE if residual.turns else MAX_SLIDE_RATE, fastest)
    if not reach or min_rate >= max_rate:
        return ()
    by_delay = [residual.spectra(d, max_rate) for d in DELAYS.tolist()]
    rate, power = by_delay[0][0], np.stack([spectra for _, spectra in by_delay])  # (D, F, K)
    # The median over neighbouring rates is the level of a broad residual; only lines far above it count.
    around = median_filter(power.mean(axis=(0, 1)), MEDIAN_WIDTH * POINTS_PER_RATE, mode="nearest")
    power *= (power > MIN_LINE_RATIO * around) & (rate >= min_rate)
    lines: dict[Line, None] = {}
    flat = power.transpose(1, 0, 2).reshape(residual.blocks, -1)
    for place in np.unique(np.argmax(flat, axis=1)[flat.any(axis=1)]).tolist():
        d, k = divmod(place, len(rate))
        lines |= dict.fromkeys(
            _refine_line(residual, (float(rate[k]), float(DELAYS[d])), reach, MAX_WHOLE_RATE_LOSS * float(around[k]))
        )
    return tuple(lines)


def _refine_line(residual: PositionResidual, line: Line, reach: float, loss: float) -> list[Line]:
    """Return the best lines near ``line``, leaving out each block in turn.

    A whole rate is preferred where it loses no more power than ``loss``.
    """
    k, d = line
    # The periodogram is too coarse for rate and delay: search a fine grid around its maximum.
    rates = k + RATE_OFFSETS * 2.0 * np.pi / reach
    whole_rates = np.unique(np.round(rates)) if residual.turns else np.zeros(0)
    whole_rates = whole_rates[(whole_rates >= rates[0]) & (whole_rates <= rates[-1])]
    delays = d + DELAY_OFFSETS
    lines = [(x, y) for x in [*rates.tolist(), *whole_rates.tolist()] for y in delays.tolist()]
    power = residual.powers(lines)
    n_free = len(rates) * len(delays)
    best = np.argmax(power[:, :n_free], axis=1)
    if len(whole_rates):
        best_whole = n_free + np.argmax(power[:, n_free:], axis=1)
        fold_index = np.arange(residual.blocks)
        best = np.where(power[fold_index, best_whole] > power[fold_index, best] - loss, best_whole, best)
    return [lines[n] for n in np.unique(best).tolist()]


def ripple_kinds(
    samples: TermSamples,
    excitation: JointExcitation,
    residual: Array,
    block: NDArray[np.intp],
    earlier: Sequence[CandidateKind],
) -> list[CandidateKind]:
    """Return the ripples of a joint, also by the load, at the largest lines in the ``residual`` (N) of other terms.

    ``block`` (N) is the block of each sample, -1 of those left out; rates of ``earlier`` ripples are not tried again.
    """
    joints, joint = excitation.joints, excitation.joint
    j = joints.index(joint)
    q, dq = (samples.states[name][:, j] for name in ("q", "dq"))
    position_residual = PositionResidual(q, dq, residual, block, samples.blocks, joint.kind == "revolute")
    # Half a period between recorded samples at the usual speed: thinned samples are not filtered, and show it, too.
    lines = largest_lines(position_residual, np.pi / samples.interval / excitation.speed)
    taken = {parameter.name for kind in earlier for term in kind.sizes(excitation) for parameter in term.parameters}
    kinds = []
    for name, law in RIPPLES.items() if samples.model.load_mask.any() else [("ripple", Ripple)]:
        terms = (law(joints, on=(joint.name,), cycles=(k,), delay=d) for k, d in lines)
        if free_terms := tuple(term for term in terms if term.parameters[0].name not in taken):
            name = f"{name} {len(earlier) + 1}" if earlier else name
            sizes = partial(fixed_terms, free_terms)
            kinds.append(CandidateKind(name, sizes, strict=True, reaches=True, needs_load=law.needs_load))
    return kinds
