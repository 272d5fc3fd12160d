"""A log as one period that repeats: which period, harmonics and rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.log import Log
from dynident.smoothers.harmonics import HarmonicSeries, by_bic, fitted_series, highest_seen, noise_power
from dynident.smoothers.period import Period, refined
from dynident.smoothers.rest import least_step
from dynident.splines import noise_sigma

__all__ = ["MOST", "PeriodicFit", "Sought", "misfit", "periods_in", "repeating", "scatter"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FIRST, MOST = 16, 1024  # harmonics that are fitted at first, to choose from, and at most
NYQUIST = 0.4  # harmonics for each sample of a period: beyond, the sampling is too slow to tell them apart
WINDOW, ODD = 1 / 8, 3.0  # of a period: parts at the ends of a log with so many times the usual residual are transients
GAP = 3.0  # times the usual step
REMAINING = 1.5  # periods without transients that let a period be found
BAND = 4.0  # times the highest harmonic, up to which what is left may be motion
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Sought:
    """What is to be found of a log: the harmonics of each joint where they are not given (n), transients at its ends
    unless it is known what ``settles``; with which joints move (n), and their noise (n)."""

    harmonics: Sequence[int | None]
    settles: bool
    moves: Mask
    sigma: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class PeriodicFit:
    """The period, harmonics (n) and series of a log's joints, of the rows ``used``, and what is left there (M, n)."""

    period: Period
    used: slice
    harmonics: NDArray[np.intp]
    series: HarmonicSeries
    left: Array

    __repr__ = brief


def periods_in(t: Array, period: float) -> float:
    """Return how many periods samples at times t (N) last."""
    return float(t[-1] - t[0]) / period * len(t) / (len(t) - 1)


def repeating(log: Log, used: slice, period: Period, sought: Sought) -> PeriodicFit:
    """Return the fit of the rows ``used`` without transients at their ends; a ``period`` with an error is refined.

    Raises InputError where more harmonics are given than the samples determine, LinAlgError where they do not determine
    the series.
    """
    if not sought.settles:
        apart = _apart(log.t[used], log.q[used], period.value)
        used = _shorter(log.t, used, apart, sought, period)
    for _ in range(ROUNDS):
        fit = _fitted(log, used, period, sought)
        if period.std:
            count = int(fit.harmonics[sought.moves].max())
            noise = np.maximum(fit.left.std(axis=0), sought.sigma)[sought.moves]
            period = refined(log.t[used], log.q[used][:, sought.moves], period.value, count, noise)
            fit = _fitted(log, used, period, sought)
        shorter = used if sought.settles else _shorter(log.t, used, fit.left, sought, period)
        if shorter == used:
            break
        used = shorter
    return fit


def _shorter(t: Array, used: slice, left: Array, sought: Sought, period: Period) -> slice:
    """Return the rows ``used`` without transients at the ends, where enough remains."""
    inner = _steady(t[used], left, sought.moves, period.value)
    inner = slice(used.start + inner.start, used.start + inner.stop)
    return used if periods_in(t[inner], period.value) < (REMAINING if period.std else 1.0) else inner


def _fitted(log: Log, used: slice, period: Period, sought: Sought) -> PeriodicFit:
    """Return the series of each joint, of the harmonics given or chosen."""
    t, q, given = log.t[used], log.q[used], sought.harmonics
    samples = len(t) / periods_in(t, period.value)
    limit = int(max(0, min(MOST, NYQUIST * samples, (len(t) - 2) // 4)))
    most = max((one for one in given if one is not None), default=0)
    if most > limit:
        raise InputError(
            f"{log.source}: {most} harmonics of {period.value:.4g} s are too many for {samples:.4g} samples a period, "
            f"{len(t)} in all; give at most {limit}, or leave them out."
        )
    harmonics = np.array([one or 0 for one in given], dtype=np.intp)
    free = np.array([one is None for one in given])
    if free.any():
        harmonics[free] = _chosen(t, q[:, free], period.value, limit)
    series = fitted_series(t, q, period.value, harmonics)
    return PeriodicFit(period, used, harmonics, series, q - series(t, 0)[0])


def _chosen(t: Array, q: Array, period: float, limit: int) -> NDArray[np.intp]:
    """Return the number of harmonics of each column."""
    count, floor = min(FIRST, limit), _floor(t, q, period)
    while True:
        series = fitted_series(t, q, period, count)
        left = q - series(t, 0)[0]
        if periods_in(t, period) >= 1.5:
            noise = noise_power(t, left, period, count)
        else:  # there is nothing between the harmonics
            noise = np.broadcast_to(4 / len(t) * np.square(noise_sigma(t, q)), (count + 1, q.shape[1]))
        best = by_bic(series, noise + floor, len(t))
        further = highest_seen(t, left, period, limit, floor)
        if count == limit or max(best.max(), further // 2) <= count // 2:
            return best
        count = min(max(2 * count, further + 1), limit)


def _floor(t: Array, q: Array, period: float) -> Array:
    """Return the mean |c|^2 (k) that the steps of an encoder, and rounding, give to each harmonic.

    Where the motion repeats they do so too: nothing of them is between the harmonics.
    """
    step = least_step(q)
    rounding = 4 * np.finfo(float).eps * np.abs(q).max(axis=0)
    repeated = np.maximum(np.where(np.isfinite(step), step, 0.0) / np.sqrt(12.0), rounding)
    return np.asarray(4.0 / len(t) * max(periods_in(t, period), 1.0) * np.square(repeated))


def _steady(t: Array, left: Array, moves: NDArray[np.bool_], period: float) -> slice:
    """Return the rows between the parts at the ends where much more is ``left`` (N, n) than elsewhere."""
    if not moves.any():
        return slice(0, len(t))
    size = np.square(left[:, moves])
    usual = np.median(size, axis=0)
    if not (usual > 0).all():
        return slice(0, len(t))
    part = ((t - t[0]) / (WINDOW * period)).astype(int)
    count = np.maximum(np.bincount(part), 1)
    each = np.sqrt(np.bincount(part, (size / usual).mean(axis=1)) / count)
    good = np.flatnonzero(each <= ODD * np.median(each[each > 0]))
    inside = np.flatnonzero((part >= good[0]) & (part <= good[-1]))
    return slice(int(inside[0]), int(inside[-1]) + 1)


def _apart(t: Array, q: Array, period: float) -> Array:
    """Return how far (N, n) each sample is from what is a period later or earlier, whichever is nearer."""
    found, step = np.full(q.shape, np.inf), np.diff(t)
    for shift in (-period, period):
        k = np.searchsorted(t, t + shift)
        inside = (k > 0) & (k < len(t)) & (step[np.clip(k - 1, 0, len(step) - 1)] <= GAP * np.median(step))
        other = np.stack([np.interp(t[inside] + shift, t, column) for column in q.T], axis=1)
        found[inside] = np.minimum(found[inside], np.abs(q[inside] - other))
    found[np.isinf(found)] = 0.0  # where there is nothing to compare with
    return found


def misfit(t: Array, fit: PeriodicFit, sought: Sought) -> tuple[Array, Array]:
    """Return which shares (n) of the motion and of its acceleration (rms) a fit leaves, beyond white noise.

    Those of the acceleration are by the spectrum of what is left, up to four times the highest harmonic of all
    joints: beyond there is noise that need not be white.
    """
    from scipy.fft import rfft

    window = np.hanning(len(t))[:, None]
    power = np.square(np.abs(rfft(fit.left * window, axis=0))) / np.square(window).sum()
    turn = 2.0 * np.pi * np.arange(len(power)) / float(t[-1] - t[0])
    highest = BAND * 2.0 * np.pi * int(fit.harmonics.max()) / fit.period.value
    beyond = np.maximum(power - np.square(sought.sigma), 0.0) * 2.0 / len(t)
    left = np.maximum(np.square(fit.left).mean(axis=0) - np.square(sought.sigma), 0.0)
    bent = (turn[:, None] ** 4 * beyond)[turn <= highest].sum(axis=0)
    shares = (x / np.maximum(x + size, 1e-300) for x, size in zip((left, bent), _sizes(fit.series), strict=True))
    return np.sqrt(next(shares)), np.sqrt(next(shares))


def _sizes(series: HarmonicSeries) -> tuple[Array, Array]:
    """Return the mean squares (n) of the motion, without its mean, and of its acceleration."""
    power = np.square(np.abs(series.coefficients[1:])) / 2.0
    turn = 2.0 * np.pi * np.arange(1, len(power) + 1)[:, None] / series.period
    return power.sum(axis=0), (power * turn**4).sum(axis=0)


def scatter(t: Array, left: Array, period: float) -> Array:
    """Return the standard deviation (n) of what differs between one period and the next: what repeats cancels.

    The next period is interpolated between two samples, which makes less of white noise by a known share.
    """
    at = t + period
    rows = np.flatnonzero(at <= t[-1])
    k = np.clip(np.searchsorted(t, at[rows], side="right") - 1, 0, len(t) - 2)
    share = ((at[rows] - t[k]) / (t[k + 1] - t[k]))[:, None]
    apart = (1 - share) * left[k] + share * left[k + 1] - left[rows]
    return np.asarray(np.sqrt(np.mean(np.square(apart) / (1 + share**2 + (1 - share) ** 2), axis=0)))
