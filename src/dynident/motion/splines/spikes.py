"""Spikes and frozen stretches of a sampled signal: samples that their neighbours do not lead up to."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.motion.splines.series import median_sigma
from dynident.runtime.arrays import Array


def stretches(mask: NDArray[np.bool_]) -> list[slice]:
    """Return the uninterrupted runs of True in a mask (N) as slices."""
    # the mask is constant between edges, so that every second interval is True
    edges = [0, *(np.flatnonzero(mask[1:] != mask[:-1]) + 1).tolist(), len(mask)]
    offset = 0 if len(mask) and mask[0] else 1
    return [slice(a, b) for a, b in zip(edges[offset:-1:2], edges[offset + 1 :: 2], strict=True)]


Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

LONGEST_SPIKE = 5  # samples of the longest spike
SHORTEST_FROZEN = 10  # samples of the shortest frozen stretch
SIDE_SAMPLES = 8  # samples on each side that say where the signal should be
MIN_CANDIDATE_DEVIATION = 3.5  # deviations of the second difference from which a sample is looked at
MIN_SPIKE_DEVIATION = 7.0  # deviations from what both sides together predict: of a normal distribution, one in 4e11
MIN_EDGE_DEVIATION = 4.0  # the same from what one side alone predicts, which is less certain
NOISE_BLOCK = 50  # samples over which the noise is taken as constant
MAX_PROBES = 2000  # samples that show the usual deviation
# noise over that of the second difference, sqrt(2/3), less as the largest of three blocks is taken
LOCAL_NOISE_FACTOR = 0.65
MAX_ROUNDS = 3  # a large spike hides a small one nearby
MIN_TEAR_RATIO = 10.0  # largest steps nearby that the step from the samples at an end to the others exceeds
MIN_REPEAT_SHARE = 0.001  # share of equal neighbours from which on values are rounded, or read less often than logged
MIN_EDGE_SHARE = 2 / 3  # share of the height of a spike by which it starts and ends at once
MIN_HEIGHT_STEPS = 2.0  # steps of such values that a spike is high
INCREMENT_PERCENTILE = 20  # percentile of the steps of such values that is about an increment
MAX_STEP_VARIATION = 1e-6  # of the step: stamps that vary less are even


def spikes(t: ArrayLike, x: ArrayLike, clear: float = MIN_SPIKE_DEVIATION) -> Mask:
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
    if len(times) < 4 * SIDE_SAMPLES:
        return np.zeros(data.shape, dtype=bool)
    return np.stack([_spikes_of_series(times, column, clear) for column in columns.T], axis=1).reshape(data.shape)


def frozen_samples(t: ArrayLike, x: ArrayLike, clear: float = MIN_SPIKE_DEVIATION) -> Mask:
    """Return which values of x (N,) or (N, n), at increasing times t (N), belong to a frozen stretch.

    That is one of at least 10 equal values, at one end of which the value jumps: it stands out from a parabola through
    the samples beyond by ``clear`` times the usual deviation, and by twice the largest step there. What comes to rest
    does not jump.
    """
    times, data = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
    columns = data.reshape(len(times), -1)
    mask = np.zeros(columns.shape, dtype=bool)
    for j, column in enumerate(columns.T):
        steps = stretches(np.diff(column) == 0)
        runs = [
            (stretch.start, stretch.stop + 1)
            for stretch in steps
            if stretch.stop + 1 - stretch.start >= SHORTEST_FROZEN
        ]
        if runs and np.ptp(column) > 0 and len(times) >= 4 * SIDE_SAMPLES:
            # only a jump at an end tells a stuck sensor from a joint that came to rest
            ends = {run: _end_jumps(times, column, *run) for run in runs}
            jumps = {
                run: max((off for off, pace in jumps_of_run if off > MIN_HEIGHT_STEPS * pace), default=0.0)
                for run, jumps_of_run in ends.items()
            }
            threshold = clear * _usual_deviation(times, column) if any(jumps.values()) else np.inf
            for (start, stop), off in jumps.items():
                mask[start:stop, j] = off > threshold
    return mask.reshape(data.shape)


def torn_ends(t: ArrayLike, x: ArrayLike, clear: float = MIN_SPIKE_DEVIATION) -> Mask:
    """Return which values of x (N,) or (N, n), at increasing times t (N), are torn off at an end.

    That is at most 5 samples at an end that a step separates from the others: ten times as large as the 8 steps
    beyond, and ``clear`` times the usual deviation. In a continuous signal, such as a position, they are wrong:
    the first message of a driver is often zero.
    """
    times, data = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
    mask = np.zeros((len(times), data[:1].size), dtype=bool)
    if len(times) < 4 * SIDE_SAMPLES:
        return mask.reshape(data.shape)
    for column, marked in zip(data.reshape(mask.shape).T, mask.T, strict=True):
        for signal, end in ((column, marked), (column[::-1], marked[::-1])):
            # a tear is one step far larger than those that follow it
            steps = np.abs(np.diff(signal[: LONGEST_SPIKE + SIDE_SAMPLES + 1]))
            torn = [
                k
                for k in range(LONGEST_SPIKE)
                if steps[k] > MIN_TEAR_RATIO * float(steps[k + 1 : k + 1 + SIDE_SAMPLES].max())
            ]
            threshold = (
                max(clear * _usual_deviation(times, column), MIN_TEAR_RATIO * _increment(column)) if torn else np.inf
            )
            end[: max((k + 1 for k in torn if steps[k] > threshold), default=0)] = True
    return mask.reshape(data.shape)


def _end_jumps(t: Array, x: Array, start: int, stop: int) -> Iterator[tuple[float, float]]:
    """Yield for each end of a stretch its jump and the largest step beyond.

    The jump is the distance of its value from a parabola through the samples beyond.
    """
    for beyond, end in (
        (np.arange(start - SIDE_SAMPLES, start), start),
        (np.arange(stop, stop + SIDE_SAMPLES), stop - 1),
    ):
        if beyond[0] >= 0 and beyond[-1] < len(t):
            deviation = _polynomial_deviations(t, x, beyond[None], np.array([[end]]), 2)
            yield float(np.abs(deviation[0, 0])), float(np.abs(np.diff(x[beyond])).max())


def bridge_gaps(t: Array, x: Array, missing: Mask) -> Array:
    """Return x (N) with the ``missing`` values (N) replaced.

    A gap gets the cubic with the values and slopes of both sides; at the ends of x, the nearest value, or a
    parabola where at most 5 values are missing.
    """
    out, present = np.array(x), ~missing
    if not present.any():
        return out
    for part in stretches(missing):
        before = np.flatnonzero(present[: part.start])[-SIDE_SAMPLES:]
        after = part.stop + np.flatnonzero(present[part.stop :])[:SIDE_SAMPLES]
        neighbours, length = np.concatenate((before, after)), part.stop - part.start
        if (part.start == 0 or part.stop == len(t)) and length <= LONGEST_SPIKE and len(neighbours) == SIDE_SAMPLES:
            out[part] -= _polynomial_deviations(t, x, neighbours[None], np.arange(part.start, part.stop)[None], 2)[0]
            continue
        if len(before) < 3 or len(after) < 3:
            out[part] = np.interp(t[part], t[present], x[present])
            continue
        ends = [(t[k[at]], *_value_and_slope(t[k], x[k], t[k[at]])) for k, at in ((before, -1), (after, 0))]
        (a, xa, va), (b, xb, vb) = ends
        s = t[part] - a  # not by SciPy's, whose import takes longer than most logs
        h, slope = b - a, (xb - xa) / (b - a)
        out[part] = xa + s * (va + s * ((3 * slope - 2 * va - vb) + s * ((va + vb - 2 * slope) / h)) / h)
    return out


def _value_and_slope(t: Array, x: Array, at: float) -> tuple[float, float]:
    """Return value and slope at a time of the parabola through samples."""
    scale = float(np.ptp(t))
    slope, value = np.polyfit((t - at) / scale, x, 2 if len(t) > 3 else 1)[-2:]
    return float(value), float(slope) / scale


def _spikes_of_series(t: Array, x: Array, clear: float) -> Mask:
    """Return the spikes of one series, the small ones after the large ones are bridged."""
    mask, cleaned = np.zeros(len(t), dtype=bool), np.array(x)
    if np.ptp(x) == 0:
        return mask
    # each round bridges the spikes found so far, which would hide smaller ones in their neighbourhood
    for _ in range(MAX_ROUNDS):
        new = _visible_spikes(t, cleaned, clear) & ~mask
        if not new.any():
            break
        mask |= new
        cleaned = bridge_gaps(t, x, mask)
    return mask


def _visible_spikes(t: Array, x: Array, clear: float) -> Mask:
    """Return the spikes that stand out while the others are still in the data."""
    mask = np.zeros(len(t), dtype=bool)
    largest_steps, (starts, nearby) = _local_steps(x), _candidates(t, x)
    # a spike must stand out over the stamps and over the sample numbers: else a wrong stamp would look like one
    even, steps = np.arange(len(t), dtype=float), np.diff(t)
    axes = [even] if np.ptp(steps) < MAX_STEP_VARIATION * float(steps.mean()) else [even, t]
    usual = [cache(partial(_usual_deviation, axis, x)) for axis in axes]  # seldom needed: most signals have no spike
    # a spike of any width begins with an edge, which few candidates have
    starts = starts[(starts >= SIDE_SAMPLES) & (starts < len(t))]
    for axis in axes:
        edge = _edge_deviations(axis, x, starts, starts[:, None] - np.arange(1, SIDE_SAMPLES + 1))
        starts = starts[np.abs(edge) > MIN_EDGE_DEVIATION * nearby[starts]]
    for width in range(1, LONGEST_SPIKE + 1):
        candidates = starts[starts + width + SIDE_SAMPLES <= len(t)]
        for axis, deviation in zip(axes, usual, strict=True):
            # the local noise first, which is at hand; the deviation in the whole log only where something remains
            candidates = _confirm_spikes(axis, x, candidates, width, nearby[candidates], clear, largest_steps)
            if len(candidates):
                candidates = _confirm_spikes(
                    axis, x, candidates, width, np.maximum(deviation(), nearby[candidates]), clear, largest_steps
                )
        for k in candidates:
            if not mask[k : k + width].any():  # a narrower one is a better account of it
                mask[k : k + width] = True
    return mask


def _confirm_spikes(
    t: Array, x: Array, starts: Index, width: int, usual: Array, clear: float, largest_steps: tuple[Array, Array]
) -> Index:
    """Return those of the ``starts`` (K) at which a spike of this width stands out.

    ``usual`` (K) is the usual deviation there.
    """
    reach, last = np.arange(1, SIDE_SAMPLES + 1), starts + width - 1
    jump_before = _edge_deviations(t, x, starts, starts[:, None] - reach)
    jump_after = _edge_deviations(t, x, last, last[:, None] + reach)
    jump = np.minimum(np.abs(jump_before), np.abs(jump_after))
    has_edges = (jump > MIN_EDGE_DEVIATION * usual) & (jump_before * jump_after > 0)
    starts, jump_before, jump, usual = starts[has_edges], jump_before[has_edges], jump[has_edges], usual[has_edges]
    deviation, side_noise = _inner_deviations(t, x, starts, width)
    same_side = (deviation * np.sign(jump_before)[:, None] > MIN_EDGE_DEVIATION * usual[:, None]).all(axis=1)
    height = np.abs(deviation).max(axis=1, initial=0.0)
    local_step = np.maximum(largest_steps[0][starts - 1], largest_steps[1][starts + width])
    clearly = height > np.maximum(clear * np.maximum(usual, side_noise), MIN_HEIGHT_STEPS * local_step)
    return np.asarray(starts[same_side & clearly & (jump > MIN_EDGE_SHARE * height)])


def _usual_deviation(t: Array, x: Array) -> float:
    """Return the usual deviation of a sample from a cubic through its neighbours, at least a third of an increment."""
    probes = np.unique(np.linspace(SIDE_SAMPLES, len(t) - SIDE_SAMPLES - 1, MAX_PROBES).astype(int))
    usual = float(median_sigma(_inner_deviations(t, x, probes, 1)[0][:, 0]))
    return max(usual, _increment(x) / 3, 1e-12 * float(np.abs(x).max()))


def _increment(x: Array) -> float:
    """Return the approximate step of the grid on which repeated values lie, zero where values do not repeat."""
    steps = np.abs(np.diff(x))
    return (
        float(np.percentile(steps[steps > 0], INCREMENT_PERCENTILE))
        if steps.any() and np.mean(steps == 0) > MIN_REPEAT_SHARE
        else 0.0
    )


def _local_steps(x: Array) -> tuple[Array, Array]:
    """Return the largest step in the 8 samples up to each, and after each, where values repeat, else zero.

    Values that are rounded, or read late, are off by about one step.
    """
    increment = _increment(x)
    if not increment:
        return np.zeros(len(x)), np.zeros(len(x))
    steps = np.maximum(trailing_maximum(np.abs(np.diff(x, prepend=x[0])), SIDE_SAMPLES), increment)
    return steps, np.append(steps[SIDE_SAMPLES:], steps[-SIDE_SAMPLES:])


def trailing_maximum(x: Array, size: int) -> Array:
    """Return the largest of the ``size`` samples up to each of x (N), which is mirrored before its start."""
    windows, width = np.pad(x, (size - 1, 0), mode="symmetric"), 1
    while width < size:  # the largest of so many samples, from two windows of fewer
        added = min(width, size - width)
        windows, width = np.maximum(windows[added:], windows[:-added]), width + added
    return windows


def _candidates(t: Array, x: Array) -> tuple[Index, Array]:
    """Return where a spike may start, and the local noise.

    Candidates are samples far from the line through their neighbours, and those after them. The noise (N) is the
    standard deviation of white noise with the same distances nearby.
    """
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    # distance from the chord of both neighbours; its median absolute value per block gives the local noise
    bend = np.concatenate(([0.0], x[1:-1] - (1 - share) * x[:-2] - share * x[2:], [0.0]))
    count = max(len(t) // NOISE_BLOCK, 1)
    size, longer = divmod(len(t), count)
    blocks = bend[: longer * (size + 1)].reshape(longer, size + 1), bend[longer * (size + 1) :].reshape(-1, size)
    sizes = np.repeat([size + 1, size], [longer, count - longer])
    middles = [np.median(block, axis=1) for block in blocks]
    middle = np.concatenate(middles)
    spread = np.concatenate([median_sigma((block - at[:, None]).T) for block, at in zip(blocks, middles, strict=True)])
    min_spread = np.maximum(spread, 0.1 * np.median(spread))
    rows = np.flatnonzero(
        np.abs(bend - np.repeat(middle, sizes)) > MIN_CANDIDATE_DEVIATION * np.repeat(min_spread, sizes)
    )
    # the noisiest of three neighbouring blocks: a block boundary must not make candidates
    around = np.max([np.roll(spread, shift) for shift in (-1, 0, 1)], axis=0)
    return np.unique(np.concatenate((rows, rows + 1))), np.repeat(LOCAL_NOISE_FACTOR * around, sizes)


def _edge_deviations(t: Array, x: Array, samples: Index, neighbours: Index) -> Array:
    """Return the deviations of samples (K) from parabolas through ``neighbours`` (K, 8) on one side."""
    return _polynomial_deviations(t, x, neighbours, samples[:, None], 2)[:, 0]


def _inner_deviations(t: Array, x: Array, starts: Index, width: int) -> tuple[Array, Array]:
    """Return the deviations of a spike's samples (K, width) from a cubic through both sides, and their noise (K)."""
    reach = np.concatenate((np.arange(-SIDE_SAMPLES, 0), np.arange(width, width + SIDE_SAMPLES)))
    neighbours, samples = starts[:, None] + reach, starts[:, None] + np.arange(width)
    deviation = _polynomial_deviations(t, x, neighbours, np.concatenate((samples, neighbours), axis=1), 3)
    return deviation[:, :width], np.asarray(median_sigma(deviation[:, width:].T))


def _polynomial_deviations(t: Array, x: Array, neighbours: Index, samples: Index, degree: int) -> Array:
    """Return the deviations of ``samples`` (K, a) from polynomials through their ``neighbours`` (K, m)."""
    if not len(neighbours):
        return np.empty((0, samples.shape[1]))
    even = t[0] == 0.0 and t[-1] == len(t) - 1.0  # samples counted, not timed: one fit for all
    rows = slice(0, 1) if even else slice(None)
    middle, scale = t[neighbours[rows]].mean(axis=1, keepdims=True), np.ptp(t[neighbours[rows]], axis=1)[:, None]
    base = x[neighbours].mean(axis=1, keepdims=True)
    A, at = (np.polynomial.polynomial.polyvander((t[k[rows]] - middle) / scale, degree) for k in (neighbours, samples))
    # least-squares weights of the neighbours at the asked samples, in centred and scaled time
    transposed = A.swapaxes(1, 2)
    weights = at @ np.linalg.solve(transposed @ A, transposed)
    return np.asarray(x[samples] - base - (weights @ (x[neighbours] - base)[..., None])[..., 0])
