"""Spikes and frozen stretches of a sampled signal: samples that nothing on one side, or on either, leads up to."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.splines.noise import median_sigma
from dynident.splines.stretches import stretches

__all__ = ["LONGEST_SPIKE", "SHORTEST_FROZEN", "bridged", "frozen", "largest_up_to", "spikes", "torn_ends"]

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]

LONGEST_SPIKE = 5  # samples of the longest spike
SHORTEST_FROZEN = 10  # samples of the shortest frozen stretch
SIDE = 8  # samples on each side that say where the signal should be
LIKELY = 3.5  # deviations of the second difference from which a sample is looked at
CLEAR = 7.0  # deviations from what both sides together predict: of a normal distribution, one in 4e11
EDGE = 4.0  # the same from what one side alone predicts, which is less certain
BLOCK = 50  # samples over which the noise is taken as constant
PROBES = 2000  # samples that show the usual deviation
NEARBY = 0.65  # noise over that of the second difference, sqrt(2/3), less as the largest of three blocks is taken
ROUNDS = 3  # a large spike hides a small one nearby
TORN = 10.0  # largest steps nearby that the step from the samples at an end to the others exceeds
REPEATS = 0.001  # share of equal neighbours from which on values are rounded, or read less often than logged
STEEP = 2 / 3  # share of the height of a spike by which it starts and ends at once
HIGH = 2.0  # steps of such values that a spike is high
FINE = 20  # percentile of the steps of such values that is about an increment
EVEN = 1e-6  # of the step: stamps that vary less are even


def spikes(t: ArrayLike, x: ArrayLike, clear: float = CLEAR) -> Mask:
    """Return which values of x (N,) or (N, n), at increasing times t (N), belong to a spike of at most 5 samples.

    A spike stands out from a cubic polynomial through 8 samples on each side by ``clear`` times the usual deviation
    from it, in the log or nearby, whichever is larger, and its first and last sample also stand out, to the same side,
    from parabolas through one side alone. So neither steps nor kinks count, which one of the sides leads up to. It must
    do so at the stamps and with equal spacing alike, or the stamps may be at fault. The first and last 8 samples are
    not looked at.

    This is Hampel's identifier (Davies and Gather, 1993) with a polynomial in place of the median.
    """
    times, data = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
    columns = data.reshape(len(times), -1)
    if len(times) < 4 * SIDE:
        return np.zeros(data.shape, dtype=bool)
    return np.stack([_all(times, column, clear) for column in columns.T], axis=1).reshape(data.shape)


def frozen(t: ArrayLike, x: ArrayLike, clear: float = CLEAR) -> Mask:
    """Return which values of x (N,) or (N, n), at increasing times t (N), belong to a frozen stretch.

    That is one of at least 10 equal values, at one end of which the value jumps: it stands out from a parabola through
    the samples beyond by ``clear`` times the usual deviation, and by twice the largest step there. What comes to rest
    does not jump.
    """
    times, data = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
    columns = data.reshape(len(times), -1)
    found = np.zeros(columns.shape, dtype=bool)
    for j, column in enumerate(columns.T):
        steps = stretches(np.diff(column) == 0)
        runs = [(one.start, one.stop + 1) for one in steps if one.stop + 1 - one.start >= SHORTEST_FROZEN]
        if runs and np.ptp(column) > 0 and len(times) >= 4 * SIDE:
            high = {run: max((off for off, pace in _ends(times, column, *run) if off > HIGH * pace), default=0.0)
                    for run in runs}  # fmt: skip
            least = clear * _usual(times, column) if any(high.values()) else np.inf
            for (start, stop), off in high.items():
                found[start:stop, j] = off > least
    return found.reshape(data.shape)


def torn_ends(t: ArrayLike, x: ArrayLike, clear: float = CLEAR) -> Mask:
    """Return which values of x (N,) or (N, n), at increasing times t (N), are at most 5 at an end that a step separates
    from the others: ten times as large as the 8 steps beyond, and ``clear`` times the usual deviation.

    Of a continuous signal, such as a position, they are wrong: the first message of a driver is often zero.
    """
    times, data = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
    found = np.zeros((len(times), data[:1].size), dtype=bool)
    if len(times) < 4 * SIDE:
        return found.reshape(data.shape)
    for column, marked in zip(data.reshape(found.shape).T, found.T, strict=True):
        for signal, end in ((column, marked), (column[::-1], marked[::-1])):
            steps = np.abs(np.diff(signal[: LONGEST_SPIKE + SIDE + 1]))
            torn = [k for k in range(LONGEST_SPIKE) if steps[k] > TORN * float(steps[k + 1 : k + 1 + SIDE].max())]
            least = max(clear * _usual(times, column), TORN * _increment(column)) if torn else np.inf
            end[: max((k + 1 for k in torn if steps[k] > least), default=0)] = True
    return found.reshape(data.shape)


def _ends(t: Array, x: Array, start: int, stop: int) -> Iterator[tuple[float, float]]:
    """Yield for each end of a stretch how far its value is from a parabola through the samples beyond, and their
    largest step."""
    for known, end in ((np.arange(start - SIDE, start), start), (np.arange(stop, stop + SIDE), stop - 1)):
        if known[0] >= 0 and known[-1] < len(t):
            off = _off(t, x, known[None], np.array([[end]]), 2)
            yield float(np.abs(off[0, 0])), float(np.abs(np.diff(x[known])).max())


def bridged(t: Array, x: Array, gone: Mask) -> Array:
    """Return x (N) with the values that are ``gone`` (N) replaced: by the cubic that the values and slopes on both
    sides give, at the ends by the nearest value, or the parabola where they are at most 5."""
    from scipy.interpolate import CubicHermiteSpline

    out, there = np.array(x), ~gone
    if not there.any():
        return out
    for part in stretches(gone):
        before = np.flatnonzero(there[: part.start])[-SIDE:]
        after = part.stop + np.flatnonzero(there[part.stop :])[:SIDE]
        known, length = np.concatenate((before, after)), part.stop - part.start
        if (part.start == 0 or part.stop == len(t)) and length <= LONGEST_SPIKE and len(known) == SIDE:
            out[part] -= _off(t, x, known[None], np.arange(part.start, part.stop)[None], 2)[0]
            continue
        if len(before) < 3 or len(after) < 3:
            out[part] = np.interp(t[part], t[there], x[there])
            continue
        ends = [(t[k[at]], *_line(t[k], x[k], t[k[at]])) for k, at in ((before, -1), (after, 0))]
        (a, xa, va), (b, xb, vb) = ends
        out[part] = CubicHermiteSpline([a, b], [xa, xb], [va, vb])(t[part])
    return out


def _line(t: Array, x: Array, at: float) -> tuple[float, float]:
    """Return value and slope at a time of the parabola through samples."""
    scale = float(np.ptp(t))
    slope, value = np.polyfit((t - at) / scale, x, 2 if len(t) > 3 else 1)[-2:]
    return float(value), float(slope) / scale


def _all(t: Array, x: Array, clear: float) -> Mask:
    """Return the spikes of one series, the small ones after the large ones are bridged."""
    found, left = np.zeros(len(t), dtype=bool), np.array(x)
    for _ in range(ROUNDS):
        new = _once(t, left, clear) & ~found
        if not new.any():
            break
        found |= new
        left = bridged(t, x, found)
    return found


def _once(t: Array, x: Array, clear: float) -> Mask:
    """Return the spikes that can be told with the others still there."""
    found = np.zeros(len(t), dtype=bool)
    paces, (starts, nearby) = _paces(x), _candidates(t, x)
    even, steps = np.arange(len(t), dtype=float), np.diff(t)
    axes = [even] if np.ptp(steps) < EVEN * float(steps.mean()) else [even, t]
    usual = [cache(partial(_usual, axis, x)) for axis in axes]  # seldom needed: most signals have no spike
    for width in range(1, LONGEST_SPIKE + 1):
        first = starts[(starts >= SIDE) & (starts + width + SIDE <= len(t))]
        for axis, deviation in zip(axes, usual, strict=True):
            first = _standing_out(axis, x, first, width, nearby[first], clear, paces)
            if len(first):
                first = _standing_out(axis, x, first, width, np.maximum(deviation(), nearby[first]), clear, paces)
        for k in first:
            if not found[k : k + width].any():  # a narrower one is a better account of it
                found[k : k + width] = True
    return found


def _standing_out(
    t: Array, x: Array, first: Rows, width: int, usual: Array, clear: float, paces: tuple[Array, Array]
) -> Rows:
    """Return the starts of spikes of that width, of those given, where the deviation (K) is usually that large."""
    left, right = _aside(t, x, first, width)
    jump = np.minimum(np.abs(left), np.abs(right))
    sure = (jump > EDGE * usual) & (left * right > 0)
    first, left, jump, usual = first[sure], left[sure], jump[sure], usual[sure]
    off, rough = _inside(t, x, first, width)
    same = (off * np.sign(left)[:, None] > EDGE * usual[:, None]).all(axis=1)
    high = np.abs(off).max(axis=1, initial=0.0)
    pace = np.maximum(paces[0][first - 1], paces[1][first + width])
    clearly = high > np.maximum(clear * np.maximum(usual, rough), HIGH * pace)
    return np.asarray(first[same & clearly & (jump > STEEP * high)])


def _usual(t: Array, x: Array) -> float:
    """Return the usual deviation of a sample from a cubic through its neighbours, at least a third of an increment."""
    probes = np.unique(np.linspace(SIDE, len(t) - SIDE - 1, PROBES).astype(int))
    usual = float(median_sigma(_inside(t, x, probes, 1)[0][:, 0]))
    return max(usual, _increment(x) / 3, 1e-12 * float(np.abs(x).max()))


def _increment(x: Array) -> float:
    """Return about the step of the grid on which values lie that repeat, zero where they do not."""
    steps = np.abs(np.diff(x))
    return float(np.percentile(steps[steps > 0], FINE)) if steps.any() and np.mean(steps == 0) > REPEATS else 0.0


def _paces(x: Array) -> tuple[Array, Array]:
    """Return the largest step in the 8 samples up to each, and after each, where values repeat, else zero.

    Values that are rounded, or read late, are off by about a step.
    """
    increment = _increment(x)
    if not increment:
        return np.zeros(len(x)), np.zeros(len(x))
    most = np.maximum(largest_up_to(np.abs(np.diff(x, prepend=x[0])), SIDE), increment)
    return most, np.append(most[SIDE:], most[-SIDE:])


def largest_up_to(x: Array, size: int) -> Array:
    """Return the largest of the ``size`` samples up to each of x (N), which is mirrored before its start."""
    found, width = np.pad(x, (size - 1, 0), mode="symmetric"), 1
    while width < size:  # the largest of so many samples, from two windows of fewer
        more = min(width, size - width)
        found, width = np.maximum(found[more:], found[:-more]), width + more
    return found


def _candidates(t: Array, x: Array) -> tuple[Rows, Array]:
    """Return where a spike may start: at or after samples that are far from the line through their neighbours; and the
    standard deviation (N) that white noise nearby has, by this distance."""
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    bend = np.concatenate(([0.0], x[1:-1] - (1 - share) * x[:-2] - share * x[2:], [0.0]))
    count = max(len(t) // BLOCK, 1)
    size, longer = divmod(len(t), count)
    blocks = bend[: longer * (size + 1)].reshape(longer, size + 1), bend[longer * (size + 1) :].reshape(-1, size)
    sizes = np.repeat([size + 1, size], [longer, count - longer])
    middles = [np.median(block, axis=1) for block in blocks]
    middle = np.concatenate(middles)
    spread = np.concatenate([median_sigma((block - at[:, None]).T) for block, at in zip(blocks, middles, strict=True)])
    least = np.maximum(spread, 0.1 * np.median(spread))
    rows = np.flatnonzero(np.abs(bend - np.repeat(middle, sizes)) > LIKELY * np.repeat(least, sizes))
    around = np.max([np.roll(spread, shift) for shift in (-1, 0, 1)], axis=0)
    return np.unique(np.concatenate((rows, rows + 1))), np.repeat(NEARBY * around, sizes)


def _aside(t: Array, x: Array, first: Rows, width: int) -> tuple[Array, Array]:
    """Return how far the first and the last sample of a spike are from parabolas through the samples on their side."""
    reach = np.arange(1, SIDE + 1)
    left = _off(t, x, first[:, None] - reach, first[:, None], 2)
    last = first[:, None] + width - 1
    return left[:, 0], _off(t, x, last + reach, last, 2)[:, 0]


def _inside(t: Array, x: Array, first: Rows, width: int) -> tuple[Array, Array]:
    """Return how far the samples (K, width) of a spike are from a cubic through those on both sides, and these (K)."""
    reach = np.concatenate((np.arange(-SIDE, 0), np.arange(width, width + SIDE)))
    known, asked = first[:, None] + reach, first[:, None] + np.arange(width)
    off = _off(t, x, known, np.concatenate((asked, known), axis=1), 3)
    return off[:, :width], np.asarray(median_sigma(off[:, width:].T))


def _off(t: Array, x: Array, known: Rows, asked: Rows, degree: int) -> Array:
    """Return by how much the ``asked`` samples (K, a) differ from polynomials through the ``known`` ones (K, m)."""
    if not len(known):
        return np.empty((0, asked.shape[1]))
    even = t[0] == 0.0 and t[-1] == len(t) - 1.0  # samples counted, not timed: one fit for all
    rows = slice(0, 1) if even else slice(None)
    middle, scale = t[known[rows]].mean(axis=1, keepdims=True), np.ptp(t[known[rows]], axis=1)[:, None]
    base = x[known].mean(axis=1, keepdims=True)
    A, at = (np.polynomial.polynomial.polyvander((t[k[rows]] - middle) / scale, degree) for k in (known, asked))
    turned = A.swapaxes(1, 2)
    weights = at @ np.linalg.solve(turned @ A, turned)
    return np.asarray(x[asked] - base - (weights @ (x[known] - base)[..., None])[..., 0])
