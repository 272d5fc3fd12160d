"""A log as one period that repeats: which period, harmonics and rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.motion.log import Log
from dynident.motion.smoothers.harmonics import (
    MIN_LINES,
    HarmonicSeries,
    choose_by_bic,
    fit_series,
    highest_harmonic,
    noise_correction,
    noise_power,
    periods_in,
    spectrum,
)
from dynident.motion.smoothers.smoother import least_step
from dynident.motion.splines import noise_sigma
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

GRID_SAMPLES = 4096  # samples on which periods are looked for
MAX_LAG_DIFFERENCE = 0.3  # of the variance: two stretches that differ by less may be two periods
MAX_LAG_SHARE = 0.55  # of a log: two periods, and what a lag may be wrong by
MAX_CANDIDATES = 12  # periods that are tried
MAX_TRIAL_HARMONICS = 16  # harmonics by which they are told apart
STRETCH_GROWTH = 3.0  # times longer stretches, one after the other, until the period is that of the whole log
MAX_REMAINDER_RATIO = 2.0  # times less is left of a motion by a longer period, where the shorter is none
STRETCH_PERIODS = 4.2  # periods in the middle of a log by which candidates are told apart
MAX_DIVISOR, MIN_PERIOD_STEPS = 24, 6.0  # periods are divided by less; and are of more samples
LAG_OFFSETS = np.linspace(-1.0, 1.0, 17)  # steps of the grid around a lag
MAX_NEWTON_STEPS = 12


@dataclass(frozen=True)
class Period:
    """A period (s) with its standard error."""

    value: float
    std: float


def likely_periods(t: Array, q: Array) -> list[float]:
    """Return periods (s) of q (N, k), the most likely first; each column counts alike.

    The candidates are lags at which the motion is most like itself, and what divides the best of them. The shortest
    comes first of which a series leaves no more than twice what that of any other leaves; then those that leave least.
    """
    grid = np.linspace(t[0], t[-1], min(GRID_SAMPLES, len(t)))
    # on an even grid and in units of its own spread each joint counts alike
    y = np.stack([np.interp(grid, t, column) for column in q.T], axis=1)
    y = (y - y.mean(axis=0)) / y.std(axis=0)
    step = grid[1] - grid[0]
    candidates = []
    for lag in _similar_lags(y)[:MAX_CANDIDATES]:
        trial_periods = [(lag + offset) * step for offset in LAG_OFFSETS]
        stretch = _middle_rows(grid, STRETCH_PERIODS * trial_periods[-1])
        period = min(trial_periods, key=lambda trial: _remaining_power(grid[stretch], y[stretch], trial))
        try:
            period = refine_period(grid, y, period, _harmonic_count(grid, period), np.ones(y.shape[1])).value
            candidates.append((_remaining_power(grid, y, period), period))
        except np.linalg.LinAlgError:
            candidates.append((np.inf, period))
    if not candidates:
        return []
    best = min(candidates)[1]
    # a lag of several periods is like one of a single period: try the divisors of the best candidate, too
    divisors = (best / k for k in range(2, MAX_DIVISOR) if best / k > MIN_PERIOD_STEPS * step)
    candidates += [(_remaining_power(grid, y, period), period) for period in divisors]
    least_remainder = min(remainder for remainder, _ in candidates)
    shortest = min(period for remainder, period in candidates if remainder <= MAX_REMAINDER_RATIO * least_remainder)
    return [shortest, *(period for _, period in sorted(candidates) if period != shortest)]


def _harmonic_count(t: Array, period: float) -> int:
    return int(min(MAX_TRIAL_HARMONICS, 0.4 * period / (t[1] - t[0])))


def _similar_lags(y: Array) -> NDArray[np.intp]:
    """Return the lags (samples) at which the columns of y (N, k) are most like themselves, the most alike first."""
    from scipy.fft import irfft, next_fast_len, rfft

    count = len(y)
    size = next_fast_len(2 * count, real=True)
    # squared differences at all lags, from a correlation by FFT and running sums of squares
    product = irfft(np.square(np.abs(rfft(y, size, axis=0))), size, axis=0)[:count].sum(axis=1)
    squares = np.concatenate([[0.0], np.cumsum(np.square(y).sum(axis=1))])
    lag = np.arange(count)
    pairs = squares[count - lag] + squares[-1] - squares[lag] - 2.0 * product
    difference = pairs / (2.0 * np.maximum(count - lag, 1) * y.shape[1])
    inner = difference[1:-1]
    minima = np.flatnonzero((inner <= difference[:-2]) & (inner < difference[2:]) & (inner < MAX_LAG_DIFFERENCE)) + 1
    minima = minima[(minima > 4) & (minima <= MAX_LAG_SHARE * count)]
    return np.asarray(minima[np.argsort(difference[minima], kind="stable")])


def _middle_rows(t: Array, length: float) -> slice:
    """Return the rows of so many seconds in the middle."""
    inside = np.flatnonzero(np.abs(t - (t[0] + t[-1]) / 2) <= length / 2)
    return slice(int(inside[0]), int(inside[-1]) + 1)


def _remaining_power(t: Array, y: Array, period: float) -> float:
    """Return the mean square of y that a series of this period leaves, inf where the series is not determined."""
    try:
        series = fit_series(t, y, period, _harmonic_count(t, period))
    except np.linalg.LinAlgError:
        return np.inf
    return float(np.square(y - series(t, 0)[0]).mean())


def refine_period(t: Array, q: Array, period: float, harmonics: int, noise: Array) -> Period:
    """Return the least-squares period near the given one; columns count by their ``noise`` (k).

    A stretch in the middle is fitted first, then longer ones, since after many periods a small error of the
    period is a large one of the phase.
    """
    length, duration = STRETCH_PERIODS * period, float(t[-1] - t[0])
    while length < duration / STRETCH_GROWTH:
        rows = _middle_rows(t, length)
        period = _newton_period(t[rows], q[rows], period, harmonics, noise).value
        length *= STRETCH_GROWTH
    return _newton_period(t, q, period, harmonics, noise)


def _newton_period(t: Array, q: Array, period: float, harmonics: int, noise: Array) -> Period:
    """Return the least-squares period by the Gauss-Newton method.

    The derivative of a series by the logarithm of its period is -(t - middle) dq, less what the series itself can
    follow. The standard error takes the noise as it is, white or not, by its spectrum.
    """
    std = 0.0
    for _ in range(MAX_NEWTON_STEPS):
        series = fit_series(t, q, period, harmonics)
        value, slope = series(t, 1)
        residual = (q - value) / noise
        sensitivity = (t - series.middle)[:, None] * slope / noise
        # the series follows a part of the change of period, which does not count
        sensitivity -= fit_series(t, sensitivity, period, harmonics)(t, 0)[0]
        size = float(np.square(sensitivity).sum())
        if not size > 0:
            break
        change = -float((sensitivity * residual).sum()) / size
        std = period * np.sqrt(_product_variance(t, sensitivity, residual, period)) / size
        period *= 1.0 + float(np.clip(change, -0.01, 0.01))
        if abs(change) * period <= 1e-3 * std or abs(change) < 1e-13:
            break
    return Period(float(period), float(std))


def _product_variance(t: Array, sensitivity: Array, residual: Array, period: float) -> float:
    """Return the variance of sum(sensitivity * residual) for noise with the spectrum of the ``residual``.

    It is at least that of white noise.
    """
    from scipy.fft import rfft

    periods = float(t[-1] - t[0]) / period
    noise = spectrum(residual, max(MIN_LINES, round(periods))) * noise_correction(periods)
    white = np.square(residual).sum(axis=0)
    power = np.square(np.abs(rfft(sensitivity, axis=0)))
    return 2.0 * float((power * np.maximum(noise, white)).sum()) / len(t) ** 2


Mask = NDArray[np.bool_]
START_HARMONICS, MAX_HARMONICS = 16, 1024  # harmonics that are fitted at first, to choose from, and at most
MAX_HARMONICS_PER_SAMPLE = 0.4  # of a period: beyond, the sampling is too slow to tell them apart
# of a period: parts at the ends of a log with so many times the usual residual are transients
END_WINDOW, MIN_TRANSIENT_RATIO = 1 / 8, 3.0
MAX_GAP_STEPS = 3.0  # times the usual step
MIN_REMAINING_PERIODS = 1.5  # periods without transients that let a period be found
MISFIT_BAND = 4.0  # times the highest harmonic, up to which what is left may be motion
MAX_FIT_ROUNDS = 3


class PeriodicFitRequest(Noun):
    """What is to be found in a log: the harmonics of each joint where they are None (n), and transients at its ends.

    Transients are not looked for where ``settling_known`` is set. ``moves`` (n) tells which joints move,
    ``sigma`` (n) is their noise.
    """

    harmonics: Sequence[int | None]
    settling_known: bool
    moves: Mask
    sigma: Array


class PeriodicFit(Noun):
    """The period, harmonics (n) and series of a log's joints, of its ``rows``, and the ``residual`` there (M, n)."""

    period: Period
    rows: slice
    harmonics: NDArray[np.intp]
    series: HarmonicSeries
    residual: Array


def fit_periodic(log: Log, rows: slice, period: Period, request: PeriodicFitRequest) -> PeriodicFit:
    """Return the fit of the ``rows`` without transients at their ends; a ``period`` with an error is refined.

    Raises InputError where more harmonics are given than the samples determine, LinAlgError where they do not
    determine the series.
    """
    if not request.settling_known:
        difference = _period_differences(log.t[rows], log.q[rows], period.value)
        rows = _trim_transients(log.t, rows, difference, request, period)
    # the period needs the rows without transients, and these rows the residual at the right period
    for _ in range(MAX_FIT_ROUNDS):
        fit = _fit_joint_series(log, rows, period, request)
        if period.std:
            count = int(fit.harmonics[request.moves].max())
            noise = np.maximum(fit.residual.std(axis=0), request.sigma)[request.moves]
            period = refine_period(log.t[rows], log.q[rows][:, request.moves], period.value, count, noise)
            fit = _fit_joint_series(log, rows, period, request)
        shorter = rows if request.settling_known else _trim_transients(log.t, rows, fit.residual, request, period)
        if shorter == rows:
            break
        rows = shorter
    return fit


def _trim_transients(t: Array, rows: slice, residual: Array, request: PeriodicFitRequest, period: Period) -> slice:
    """Return the ``rows`` without transients at the ends, where enough remains."""
    inner = _steady_rows(t[rows], residual, request.moves, period.value)
    inner = slice(rows.start + inner.start, rows.start + inner.stop)
    return rows if periods_in(t[inner], period.value) < (MIN_REMAINING_PERIODS if period.std else 1.0) else inner


def _fit_joint_series(log: Log, rows: slice, period: Period, request: PeriodicFitRequest) -> PeriodicFit:
    """Return the series of each joint, with the harmonics given or chosen."""
    t, q, requested = log.t[rows], log.q[rows], request.harmonics
    samples = len(t) / periods_in(t, period.value)
    limit = int(max(0, min(MAX_HARMONICS, MAX_HARMONICS_PER_SAMPLE * samples, (len(t) - 2) // 4)))
    max_given = max((number for number in requested if number is not None), default=0)
    if max_given > limit:
        raise InputError(
            f"{log.source}: {max_given} harmonics of {period.value:.4g} s are too many for {samples:.4g} samples a "
            f"period, {len(t)} in all; give at most {limit}, or leave them out."
        )
    harmonics = np.array([number or 0 for number in requested], dtype=np.intp)
    free = np.array([number is None for number in requested])
    if free.any():
        harmonics[free] = _choose_harmonics(t, q[:, free], period.value, limit)
    series = fit_series(t, q, period.value, harmonics)
    return PeriodicFit(period, rows, harmonics, series, q - series(t, 0)[0])


def _choose_harmonics(t: Array, q: Array, period: float, limit: int) -> NDArray[np.intp]:
    """Return the number of harmonics of each column."""
    count, floor = min(START_HARMONICS, limit), _quantisation_floor(t, q, period)
    while True:
        # as many harmonics again while the best number, or a line that stands out, is near the end of those fitted
        series = fit_series(t, q, period, count)
        residual = q - series(t, 0)[0]
        if periods_in(t, period) >= 1.5:
            noise = noise_power(t, residual, period, count)
        else:  # there is nothing between the harmonics
            noise = np.broadcast_to(4 / len(t) * np.square(noise_sigma(t, q)), (count + 1, q.shape[1]))
        best = choose_by_bic(series, noise + floor, len(t))
        further = highest_harmonic(t, residual, period, limit, floor)
        if count == limit or max(best.max(), further // 2) <= count // 2:
            return best
        count = min(max(2 * count, further + 1), limit)


def _quantisation_floor(t: Array, q: Array, period: float) -> Array:
    """Return the mean |c|^2 (k) that the steps of an encoder, and rounding, give to each harmonic.

    Where the motion repeats they do so too: nothing of them is between the harmonics.
    """
    step = least_step(q)
    rounding = 4 * np.finfo(float).eps * np.abs(q).max(axis=0)
    repeated = np.maximum(np.where(np.isfinite(step), step, 0.0) / np.sqrt(12.0), rounding)
    return np.asarray(4.0 / len(t) * max(periods_in(t, period), 1.0) * np.square(repeated))


def _steady_rows(t: Array, residual: Array, moves: NDArray[np.bool_], period: float) -> slice:
    """Return the rows between the parts at the ends whose ``residual`` (N, n) is much larger than elsewhere."""
    if not moves.any():
        return slice(0, len(t))
    size = np.square(residual[:, moves])
    typical = np.median(size, axis=0)
    if not (typical > 0).all():
        return slice(0, len(t))
    # the level of each window of an eighth of a period, relative to the typical residual of each joint
    part = ((t - t[0]) / (END_WINDOW * period)).astype(int)
    count = np.maximum(np.bincount(part), 1)
    levels = np.sqrt(np.bincount(part, (size / typical).mean(axis=1)) / count)
    good = np.flatnonzero(levels <= MIN_TRANSIENT_RATIO * np.median(levels[levels > 0]))
    inside = np.flatnonzero((part >= good[0]) & (part <= good[-1]))
    return slice(int(inside[0]), int(inside[-1]) + 1)


def _period_differences(t: Array, q: Array, period: float) -> Array:
    """Return the distance (N, n) of each sample from that one period later or earlier, whichever is nearer."""
    difference, step = np.full(q.shape, np.inf), np.diff(t)
    # compare each sample with its neighbours one period earlier and later; gaps have none
    for shift in (-period, period):
        k = np.searchsorted(t, t + shift)
        inside = (k > 0) & (k < len(t)) & (step[np.clip(k - 1, 0, len(step) - 1)] <= MAX_GAP_STEPS * np.median(step))
        neighbour = np.stack([np.interp(t[inside] + shift, t, column) for column in q.T], axis=1)
        difference[inside] = np.minimum(difference[inside], np.abs(q[inside] - neighbour))
    difference[np.isinf(difference)] = 0.0  # where there is nothing to compare with
    return difference


def misfit(t: Array, fit: PeriodicFit, request: PeriodicFitRequest) -> tuple[Array, Array]:
    """Return the shares (n) of the motion and of its acceleration (rms) that a fit leaves, beyond white noise.

    Those of the acceleration are by the spectrum of the residual, up to four times the highest harmonic of all
    joints: beyond there is noise that need not be white.
    """
    from scipy.fft import rfft

    window = np.hanning(len(t))[:, None]
    power = np.square(np.abs(rfft(fit.residual * window, axis=0))) / np.square(window).sum()
    turn = 2.0 * np.pi * np.arange(len(power)) / float(t[-1] - t[0])
    highest = MISFIT_BAND * 2.0 * np.pi * int(fit.harmonics.max()) / fit.period.value
    # the spectrum of the residual above white noise, of which only motion, not coloured noise, should remain
    beyond = np.maximum(power - np.square(request.sigma), 0.0) * 2.0 / len(t)
    excess = np.maximum(np.square(fit.residual).mean(axis=0) - np.square(request.sigma), 0.0)
    acceleration_excess = (turn[:, None] ** 4 * beyond)[turn <= highest].sum(axis=0)
    pairs = zip((excess, acceleration_excess), _mean_squares(fit.series), strict=True)
    motion_share, acceleration_share = (np.sqrt(x / np.maximum(x + size, 1e-300)) for x, size in pairs)
    return motion_share, acceleration_share


def _mean_squares(series: HarmonicSeries) -> tuple[Array, Array]:
    """Return the mean squares (n) of the motion, without its mean, and of its acceleration."""
    power = np.square(np.abs(series.coefficients[1:])) / 2.0
    turn = 2.0 * np.pi * np.arange(1, len(power) + 1)[:, None] / series.period
    return power.sum(axis=0), (power * turn**4).sum(axis=0)


def scatter(t: Array, residual: Array, period: float) -> Array:
    """Return the standard deviation (n) of the difference between one period and the next: what repeats cancels.

    The next period is interpolated between two samples, which reduces white noise by a known share.
    """
    at = t + period
    rows = np.flatnonzero(at <= t[-1])
    k = np.clip(np.searchsorted(t, at[rows], side="right") - 1, 0, len(t) - 2)
    share = ((at[rows] - t[k]) / (t[k + 1] - t[k]))[:, None]
    deviation = (1 - share) * residual[k] + share * residual[k + 1] - residual[rows]
    # interpolation with shares s and 1 - s leaves s^2 + (1 - s)^2 of the noise variance
    return np.asarray(np.sqrt(np.mean(np.square(deviation) / (1 + share**2 + (1 - share) ** 2), axis=0)))
