"""Whether two recordings are of the same motion, at any lag, or hold the same samples; where a motion repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.filters import correlated
from dynident.log import Log, Motion

__all__ = ["REPEATED", "Repeat", "repeat_of", "repeated_rows"]

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

REPEATED = 10.0  # %, difference of positions and torques below which two recordings are of one motion
POINTS = 2**15  # of the common time axis of each recording
FINE_POINTS = 4000  # of a recording, to refine the lag
OVERLAP = 0.5  # share of the recording that the other must overlap
SAME = 5.0  # %, difference of positions below which the samples of a motion are those of another pass
OTHER = 50.0  # %, above which they are of another motion: before the first such lag, a log resembles itself
COARSE = 2**12  # points of the time axis on which passes are sought
SHARED = 0.1  # share of a log that must have been passed twice
STILL = 0.05  # of the largest range of a joint: with a smaller one a joint hardly moves


@dataclass(frozen=True)
class Repeat:
    """The ``lag`` (s), counted from both starts, at which another recording resembles one most, and there the relative
    differences (%) of the torques and of the positions about their mean; infinite where the other is too short.

    A joint's position counts by its range, so that rad and m can be compared, unless it hardly moves."""

    lag: float
    torque: float
    position: float

    @property
    def error(self) -> float:
        """The larger difference (%)."""
        return max(self.torque, self.position)


def repeat_of(one: Log | Motion, other: Log | Motion) -> Repeat:
    """Return how far the other recording repeats the motion of the one, at the best lag.

    The squared difference at all lags is a cross-correlation and two running sums of squares; the lag is refined to a
    tenth of a sample. A motion that is repeated faster, slower or backwards is another motion.
    """
    lengths = [float(np.ptp(x.t)) for x in (one, other)]
    step = max(*(float(np.median(np.diff(x.t))) for x in (one, other)), max(lengths) / POINTS)
    span = np.ptp(one.q, axis=0)
    span = np.maximum(span, STILL * span.max()) if span.any() else np.ones(len(span))
    a, b = _even(one, step, span), _even(other, step, span)
    if min(len(a), len(b)) < 10 or len(b) < OVERLAP * len(a):
        return Repeat(0.0, np.inf, np.inf)
    n = a.shape[1] // 2
    middle = np.concatenate((a[:, :n].mean(axis=0), np.zeros(n)))  # the torque's mean is gravity
    a, b = a - middle, b - middle
    parts = [_differences(a[:, part], b[:, part]) for part in (slice(0, n), slice(n, 2 * n))]
    lags = np.arange(-len(a) + 1, len(b))
    total = np.maximum(*parts)
    total[_overlap(len(a), len(b)) < OVERLAP * len(a)] = np.inf
    best = float(lags[int(np.argmin(total))])
    near, every = (best + np.linspace(-1, 1, 21)) * step, max(1, len(one) // FINE_POINTS)
    finest = min(near, key=lambda lag: _at(one, other, float(lag), span, every).error)
    return _at(one, other, float(finest), span)


def repeated_rows(one: Motion, other: Motion) -> tuple[Rows, Rows] | None:
    """Return usable samples of one motion and those of the other that pass the same positions, to half a sample.

    Both may be the same motion, which then passes them again later. None where there are fewer than a tenth.
    """
    lag = _lag(one, other)
    if lag is None:
        return None
    wanted = one.t - one.t[0] + lag
    at = np.interp(wanted, other.t - other.t[0], np.arange(len(other.t)), left=-1, right=-1)
    nearest = np.rint(at).astype(np.intp)
    use = (at >= 0) & one.mask & other.mask[nearest]
    rows = np.flatnonzero(use), nearest[use]
    whole = float(np.square(one.q[rows[0]] - one.q[rows[0]].mean(axis=0)).sum()) if use.any() else 0.0
    apart = float(np.square(one.q[rows[0]] - other.q[rows[1]]).sum())
    return rows if use.sum() > SHARED * len(one) and apart < (SAME / 100) ** 2 * whole else None


def _lag(one: Motion, other: Motion) -> float | None:
    """Return the lag (s), counted from both starts, at which positions differ least; None where they always differ."""
    lengths = [float(np.ptp(x.t)) for x in (one, other)]
    step = max(*(float(np.median(np.diff(x.t))) for x in (one, other)), max(lengths) / COARSE)
    a, b = (np.column_stack([np.interp(np.arange(x.t[0], x.t[-1], step), x.t, q) for q in x.q.T]) for x in (one, other))
    if min(len(a), len(b)) < 10 or not np.ptp(a, axis=0).any():
        return None
    lags, apart = np.arange(-len(a) + 1, len(b)), _differences(a - a.mean(axis=0), b - a.mean(axis=0))
    apart[_overlap(len(a), len(b)) < SHARED * len(a)] = np.inf
    if one is other:
        apart[lags < np.argmax((lags > 0) & (apart > (OTHER / 100) ** 2) & np.isfinite(apart)) - len(a) + 1] = np.inf
    best = int(np.argmin(apart))
    if not apart[best] < (2 * SAME / 100) ** 2:
        return None
    every = max(1, len(one) // FINE_POINTS)
    near = (lags[best] + np.linspace(-1, 1, 41)) * step
    return float(min(near, key=lambda lag: _passed(one, other, float(lag), every)))


def _passed(one: Motion, other: Motion, lag: float, every: int) -> float:
    """Return the mean squared difference of positions at a lag (s), at every so many stamps of the one."""
    t, u = one.t[::every] - one.t[0] + lag, other.t - other.t[0]
    use = (t >= 0) & (t <= u[-1])
    twin = np.column_stack([np.interp(t[use], u, q) for q in other.q.T])
    return float(np.mean(np.square(one.q[::every][use] - twin))) if use.any() else np.inf


def _even(one: Log | Motion, step: float, span: Array) -> Array:
    """Return positions over their ranges ``span`` (n), and torques (N, 2 n), at equal steps (s) from the start."""
    t = np.arange(one.t[0], one.t[-1] + step / 2, step)
    both = np.column_stack((one.q / span, one.tau))
    return np.column_stack([np.interp(t, one.t, x) for x in both.T])


def _overlap(a: int, b: int) -> Array:
    """Return the number of common samples at the lags -a + 1 to b - 1."""
    lags = np.arange(-a + 1, b)
    return np.asarray(np.minimum(a, b - lags) - np.maximum(0, -lags), dtype=float)


def _differences(a: Array, b: Array) -> Array:
    """Return sum |a(k) - b(k + lag)|^2 over sum |a(k)|^2 at the lags -a + 1 to b - 1, over the common samples."""
    crossed = np.sum([correlated(x, y) for x, y in zip(a.T, b.T, strict=True)], axis=0)
    left, right = (np.concatenate(([0.0], np.cumsum(np.square(x).sum(axis=1)))) for x in (a, b))
    lags = np.arange(-len(a) + 1, len(b))
    start, stop = np.maximum(0, -lags), np.minimum(len(a), len(b) - lags)
    size = left[stop] - left[start]
    whole = size + right[stop + lags] - right[start + lags] - 2 * crossed
    return np.where(size > 1e-12 * left[-1], np.maximum(whole, 0.0) / np.maximum(size, 1e-300), np.inf)


def _at(one: Log | Motion, other: Log | Motion, lag: float, span: Array, every: int = 1) -> Repeat:
    """Return the differences at a lag (s), at every so many stamps of the one."""
    t, u = one.t[::every] - one.t[0] + lag, other.t - other.t[0]
    use = (t >= 0) & (t <= u[-1])
    if use.sum() < OVERLAP * len(t):
        return Repeat(lag, np.inf, np.inf)
    errors = []
    ones = np.ones(len(span))
    # one search for all columns, as np.interp does for each
    k = np.clip(np.searchsorted(u, t[use], side="right") - 1, 0, len(u) - 2)
    share = ((t[use] - u[k]) / (u[k + 1] - u[k]))[:, None]
    for mine, its, about, unit in ((one.tau, other.tau, 0.0, ones), (one.q, other.q, one.q.mean(axis=0), span)):
        twin, own = its[k] + share * (its[k + 1] - its[k]), mine[::every][use]
        size, left = (float(np.sqrt(np.square(x / unit).sum())) for x in (own - about, own - twin))
        errors.append(100.0 * left / size if size > 0 else np.inf)
    return Repeat(lag, *errors)
