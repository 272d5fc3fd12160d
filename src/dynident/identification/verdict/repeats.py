"""Whether a log repeats the motion of another, begun at any time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.log import Motion

__all__ = ["least_difference"]

Array = NDArray[np.float64]

SAMPLES = 20_000  # at most, of one motion
OVERLAP = 0.5  # share of the first motion that both must cover
FEWEST = 10  # samples in common


def least_difference(one: Motion, other: Motion) -> float:
    """Return the least relative difference (%) of the torques of one motion from those of another, over all lags.

    It is relative to how much they vary: at low speeds most of a torque is a mean weight, the same in any motion. By
    correlation: |a - b|^2 = |a|^2 + |b|^2 - 2 a b, each sum over the usable samples that both have at a lag.
    Infinite where they never have enough in common.
    """
    step = max(float(np.median(np.diff(one.t))), (one.t[-1] - one.t[0]) / SAMPLES)
    mean = one.tau[one.mask].mean(axis=0) if one.mask.any() else np.zeros(one.tau.shape[1])
    (a, used), (b, known) = _even(one, step, mean), _even(other, step, mean)
    size = len(a) + len(b) - 1
    common = _correlated(used[:, None], known[:, None], size)
    own = _correlated(a**2, np.tile(known[:, None], a.shape[1]), size)
    rest = own + _correlated(np.tile(used[:, None], a.shape[1]), b**2, size) - 2.0 * _correlated(a, b, size)
    enough = common >= max(OVERLAP * used.sum(), FEWEST)
    share = rest[enough] / np.maximum(own[enough], np.finfo(float).tiny)
    return 100.0 * float(np.sqrt(max(share.min(), 0.0))) if enough.any() else float("inf")


def _even(motion: Motion, step: float, mean: Array) -> tuple[Array, Array]:
    """Return torques (M, n) above a mean at even steps (s), 0 where they are not usable, and where they are, 1 (M)."""
    t = np.arange(motion.t[0], motion.t[-1] + 0.5 * step, step)
    used = np.interp(t, motion.t, motion.mask.astype(float)) > 0.5
    tau = np.column_stack([np.interp(t, motion.t, column) for column in (motion.tau - mean).T])
    return tau * used[:, None], used.astype(float)


def _correlated(a: Array, b: Array, size: int) -> Array:
    """Return the sums over joints of a[k] b[k + lag], for all lags."""
    from scipy.fft import irfft, next_fast_len, rfft

    length = next_fast_len(size, real=True)
    spectrum = np.conj(rfft(a, length, axis=0)) * rfft(b, length, axis=0)
    return np.asarray(irfft(spectrum.sum(axis=1), length))
