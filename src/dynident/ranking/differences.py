"""Whether one combination predicts better than others by more than chance: a paired block bootstrap.

Errors of neighbouring samples are alike, and all combinations are judged on the same samples. Therefore whole blocks of
time are drawn anew (circular block bootstrap; Politis and Romano, 1992), the same ones for all combinations; their
length follows from the correlation of the differences (Politis and White, 2004, corrected by Patton, Politis and White,
2009). Which combination is best is chosen by the data, too: a combination is called worse only where it is worse than
any other by more than the maximum of all its differences is by chance (Hsu, 1981, "Simultaneous confidence intervals
for all distances from the best"). Those that are not called worse hold the one that is truly best with 95 %.

The error of a combination is the geometric mean over joints of their relative errors. Its logarithm is, up to what all
have in common, the negative likelihood of Gaussian residuals whose size is each joint's own: one percent less in any
joint counts the same, and neither units, gains nor how much torque a joint has change the order. An arithmetic mean is
that of the joints with hardly any torque, the error of all torques together that of the strongest joint.

N blocks scatter as little as they are few: differences by chance are taken as those of Student's distribution where
they would be normal, with N / 2 - 1 degrees of freedom as long blocks are not independent either, times
sqrt(N / (N - 2)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri, stdtrit

from dynident.errors import brief

__all__ = ["Differences", "differences", "joint_errors", "mean_error"]

Array = NDArray[np.float64]
DRAWS = 2000
LEVEL = 0.05
FEWEST = 12  # drawn blocks that the data must have: fewer do not show how they scatter
LEADING, NEAR = 10, 2.0  # combinations, of up to so many times the least error, that say how long a block must be
EXACT = 1e-6  # relative error below which a joint counts as exact
QUIET = 2.0  # times sqrt(log10 K / K): a smaller autocorrelation counts as none


@dataclass(frozen=True, eq=False)
class Differences:
    """Of R combinations: the ``error`` (R) in % (geometric mean over joints), the ends (R, 2) of the 95 % ``interval``
    of its difference to that of the best (percentage points), and the ``p_value`` (R) that it is as good as any other.

    ``length`` is the number of blocks that are drawn together, ``drawn`` how many such there are in the data. With
    fewer than 12 of them nothing is known of chance: interval and p-value are nan.
    """

    error: Array
    interval: Array
    p_value: Array
    length: int
    drawn: float

    __repr__ = brief

    @property
    def told(self) -> bool:
        """Whether there are enough blocks to tell differences from chance."""
        return self.drawn >= FEWEST


def joint_errors(squares: Array, torque: Array) -> Array:
    """Return relative errors (..., n) in % from sums of squares (..., n) of residual and torque; nan without torque."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(torque > 0, 100.0 * np.sqrt(squares / torque), np.nan))


def mean_error(squares: Array, torque: Array) -> Array:
    """Return the geometric mean (...) over the joints of their relative errors (%), of joints that have a torque.

    A relative error below 1e-6 counts as that: of exact data rounding should not decide.
    """
    known = np.broadcast_to(torque > 0, np.shape(squares))
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(np.maximum(joint_errors(squares, torque), 100.0 * EXACT))
        return np.asarray(np.exp(np.where(known, logs, 0.0).sum(axis=-1) / known.sum(axis=-1)))


def differences(
    squares: Array, torque: Array, log: Sequence[int] | NDArray[np.intp], rng: np.random.Generator
) -> Differences:
    """Return the differences of R combinations, of which ``squares`` (R, K, n) are the sums of squares of the residual
    in K blocks of time, those of the ``torque`` (K, n) the same for all; ``log`` (K) is the recording of each block."""
    error = mean_error(squares.sum(axis=1), torque.sum(axis=0))
    best, owner = int(np.argmin(error)), np.asarray(log)
    length = _length(squares, torque, error, best)
    lengths = [min(length, count) for count in np.bincount(owner) if count]
    drawn = float(
        sum(count / one for count, one in zip(np.bincount(owner)[np.bincount(owner) > 0], lengths, strict=True))
    )
    none = Differences(error, np.full((len(error), 2), np.nan), np.full(len(error), np.nan), length, drawn)
    if not none.told:
        return none
    drawn_errors = _drawn(squares, torque, owner, length, rng)
    wider, apart = _wider(drawn), error - error[best]
    ends = np.quantile(drawn_errors - drawn_errors[:, [best]], [LEVEL / 2, 1 - LEVEL / 2], axis=0).T
    interval = apart[:, None] + wider * (ends - apart[:, None])
    return Differences(error, interval, _p_values(np.log(error), np.log(drawn_errors), drawn), length, drawn)


def _length(squares: Array, torque: Array, error: Array, best: int) -> int:
    """Return how many blocks must be drawn together: the most that a difference among the leading ones needs."""
    size = np.maximum(squares[best].sum(axis=0), EXACT**2 * torque.sum(axis=0))
    known = torque.sum(axis=0) > 0
    shares = squares[:, :, known] / size[known]
    leading = [k for k in np.argsort(error, kind="stable")[: LEADING + 1] if error[k] <= NEAR * error[best]]
    return max((_block_length((shares[k] - shares[best]).sum(axis=1)) for k in leading if k != best), default=1)


def _block_length(series: Array) -> int:
    """Return the block length for a series (K) after Politis and White (2004), with the flat-top lag window."""
    count, x = len(series), series - series.mean()
    power = float(x @ x)
    if count < 8 or power <= 0:
        return 1
    lags = min(count - 1, int(np.ceil(np.sqrt(count))) + max(5, int(np.sqrt(np.log10(count)))))
    R = np.array([x[: count - k] @ x[k:] for k in range(lags + 1)]) / count
    quiet = np.abs(R[1:]) < QUIET * np.sqrt(np.log10(count) / count) * R[0]
    run = max(5, int(np.sqrt(np.log10(count))))
    last = next((k for k in range(len(quiet) - run + 1) if quiet[k : k + run].all()), len(quiet))
    reach = min(2 * max(last, 1), lags)
    k = np.arange(-reach, reach + 1)
    window = np.clip(2.0 * (1.0 - np.abs(k) / reach), 0.0, 1.0)
    both = window * R[np.abs(k)]
    spectrum, slope = both.sum(), (np.abs(k) * both).sum()
    if spectrum <= 0:
        return 1
    length = (2.0 * slope**2 / (4.0 / 3.0 * spectrum**2)) ** (1 / 3) * count ** (1 / 3)
    return int(np.clip(np.ceil(length), 1, np.ceil(min(3 * np.sqrt(count), count / 3))))


def _drawn(squares: Array, torque: Array, owner: NDArray[np.intp], length: int, rng: np.random.Generator) -> Array:
    """Return the errors (D, R) of recordings of blocks that are drawn anew, as many from each log as it has."""
    counts = np.zeros((DRAWS, len(owner)))
    for log in np.unique(owner):
        places = np.flatnonzero(owner == log)
        own = min(length, len(places))
        starts = rng.integers(len(places), size=(DRAWS, -(-len(places) // own)))
        picks = (starts[:, :, None] + np.arange(own)).reshape(DRAWS, -1)[:, : len(places)] % len(places)
        rows = np.repeat(np.arange(DRAWS), len(places))
        np.add.at(counts, (rows, places[picks.ravel()]), 1.0)
    whole = counts @ torque
    R, K, n = squares.shape
    left = (counts @ squares.transpose(1, 0, 2).reshape(K, R * n)).reshape(DRAWS, R, n)
    return mean_error(left, whole[:, None, :])


def _wider(blocks: float) -> float:
    """Return by how much the half of an interval is larger than so many blocks show."""
    return float(_students(ndtri(1 - LEVEL / 2), blocks) / ndtri(1 - LEVEL / 2))


def _students(normal: Array | float, blocks: float) -> Array:
    """Return what normal values become whose scatter is known from so many blocks only."""
    tail = np.asarray(stdtrit(blocks / 2 - 1, np.minimum(ndtr(normal), 1 - 1e-12)))
    return np.asarray(tail * np.sqrt(blocks / (blocks - 2)))


def _p_values(error: Array, drawn: Array, blocks: float) -> Array:
    """Return for each combination how likely chance makes it as much worse than some other as it is, from the
    logarithms of the errors (R) and of those of drawn blocks (D, R)."""
    found = np.ones(len(error))
    for k in range(len(error)):
        apart, moved = error[k] - error, drawn[:, [k]] - drawn
        std = moved.std(axis=0, ddof=1)
        other = (std > 1e-9) & (np.arange(len(error)) != k)
        if other.any():
            most = _students(((moved - apart)[:, other] / std[other]).max(axis=1), blocks)
            found[k] = (1 + np.sum(most >= (apart[other] / std[other]).max())) / (1 + len(most))
    return found
