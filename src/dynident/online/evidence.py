"""How unlikely a window of blocks is where nothing has changed, and from what on that counts as a change.

Each group of directions is tried on windows of all lengths that end now: the likelihood ratio of a change of this
group alone, divided by the usual scatter, is F distributed, of which minus the logarithm of the tail probability is the
evidence. Were all tests independent, a day of B blocks, W windows and G groups would have the evidence x by chance
B W G exp(-x) times; they are not, and how many they amount to is counted by simulation. Siegmund and Venkatraman
(1995), "Using the generalized likelihood ratio statistic for sequential detection of a change-point".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, brief

__all__ = ["Threshold", "evidence", "gains", "threshold"]

Array = NDArray[np.float64]
ALONE = 1e-6  # of the largest information of a direction of the group: less is none
HOUR = 720  # blocks that are drawn together, with one scatter
HOURS = 160
SEEN = 0.3  # share of the hours that exceed the evidence at which chance alarms are counted
FEWEST = 1e-280  # below, the tail probability is given by its leading term
LONGEST = 512  # blocks of the windows in the draws


@dataclass(frozen=True)
class Threshold:
    """The evidence from which on a change is reported, at ``rate`` false alarms a day with blocks of ``block`` s."""

    rate: float
    block: float
    evidence: float

    __repr__ = brief


def evidence(gain: Array, rank: NDArray[np.intp] | int, dof: float) -> Array:
    """Return -log P(F > gain / rank) for gains of F with ``rank`` and ``dof`` degrees of freedom; zero of rank 0."""
    from scipy.special import betainc, betaln

    k = np.broadcast_to(np.asarray(rank, dtype=float), np.shape(gain))
    a, b = dof / 2, np.maximum(k, 1.0) / 2
    z = dof / (dof + np.maximum(gain, 0.0))
    tail = betainc(a, b, z)
    lead = -a * np.log(z) + np.log(a) + betaln(a, b)  # betainc(a, b, z) = z^a / (a B(a, b)) of small z
    found = np.where(tail > FEWEST, -np.log(np.maximum(tail, FEWEST)), lead)
    return np.asarray(np.where(k > 0, np.maximum(found, 0.0), 0.0))


def gains(scores: Array, information: Array, covariance: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return u' V^-1 u (S) of scores u (S, k) with ``covariance`` V (S, k, k), and the ranks (S).

    Only directions in which the ``information`` (S, k, k) is not too small for rounding count.
    """
    scale = np.sqrt(np.einsum("sii->si", information))
    scale = np.where(scale > 0, scale, 1.0)
    outer = scale[:, :, None] * scale[:, None, :]
    size, axes = np.linalg.eigh(information / outer)
    shown = size > ALONE * np.maximum(size[:, -1:], 1e-300)
    shown &= np.einsum("sii->s", information)[:, None] > 0
    turned = axes.swapaxes(1, 2) @ (scores / scale)[:, :, None]
    V = axes.swapaxes(1, 2) @ (covariance / outer) @ axes
    keep = shown[:, :, None] & shown[:, None, :]
    V = np.where(keep, V, 0.0) + np.eye(V.shape[1]) * ~shown[:, :, None]
    u = np.where(shown[:, :, None], turned, 0.0)
    return np.einsum("ski,ski->s", u, np.linalg.solve(V, u)), shown.sum(axis=1)


def threshold(
    rate: float, block: float, ranks: Sequence[int], dof: float, rng: np.random.Generator, baseline: int
) -> Threshold:
    """Return the evidence that robots without a change have ``rate`` times a day, for groups of ``ranks`` directions.

    ``block`` (s) is the length of a block; ``rng`` draws ``HOURS`` hours without change, each with a scatter by ``dof``
    degrees of freedom and a reference by ``baseline`` blocks. From the evidence that a good part of these hours have,
    the rate falls as exp(-x): that is what evidence is. Raises ConfigError for a rate that is not positive.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise ConfigError(f"false alarms a day are {rate}; give a positive number, such as 0.03 (one in a month).")
    most = np.zeros(HOURS)
    for k in sorted(set(ranks)):
        count = list(ranks).count(k)
        for start in range(0, HOURS, 20):
            hours = min(20, HOURS - start)
            z = rng.standard_normal((HOUR, hours, count, k))
            off = rng.standard_normal((hours, count, k)) / np.sqrt(baseline)
            heavy = dof / rng.chisquare(dof, (hours, count))
            found = _largest(z, off, baseline) * heavy
            shown = evidence(found, k, dof).max(axis=1)
            most[start : start + hours] = np.maximum(most[start : start + hours], shown)
    x = float(np.quantile(most, 1 - SEEN))
    hourly = -np.log(1 - SEEN)  # alarms at x in an hour
    daily = hourly * 86_400.0 / (HOUR * block)
    return Threshold(rate, block, x + float(np.log(daily / rate)))


def _largest(z: Array, off: Array, baseline: int) -> Array:
    """Return the largest gain (hours, count) over all windows of draws z (blocks, hours, count, k)."""
    total = np.concatenate([np.zeros((1, *z.shape[1:])), np.cumsum(z, axis=0)])
    best, length = np.zeros(z.shape[1:3]), 1
    while length <= min(LONGEST, len(z)):
        sums = total[length:] - total[:-length] + length * off
        best = np.maximum(best, ((sums**2).sum(axis=-1) / (length + length**2 / baseline)).max(axis=0))
        length += max(1, length // 4)
    return best
