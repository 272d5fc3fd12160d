"""Joints at rest in a whole log, which no smoother need follow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["at_rest", "least_step", "with_rest"]

Array = NDArray[np.float64]
STILL = 3.0  # times the noise: a joint that moves less in the whole log is at rest
FEW = 1000  # samples in which a step is looked for that is less than what an encoder at rest may show


def at_rest(q: Array, smoothed: Array, noise: Array) -> NDArray[np.bool_]:
    """Return which joints (n) are at rest: within the noise, or within two counts of a quantised encoder."""
    span = np.ptp(q, axis=0)
    flicker = span <= 2.001 * least_step(q[:FEW])  # which is no less than that of all
    if flicker.any():
        count = least_step(q)
        flicker = span <= np.where(np.isfinite(count), 2.001 * count, 0.0)
    return np.asarray((np.ptp(smoothed, axis=0) <= STILL * noise) | flicker)


def with_rest(still: NDArray[np.bool_], q: Array, motion: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """Return q, dq, ddq (N, n) of a motion with the joints at rest at their mean of the measured ``q``."""
    if not still.any():
        return motion
    rests = (q.mean(axis=0), np.zeros(1), np.zeros(1))
    found = [np.where(still, rest, part) for rest, part in zip(rests, motion, strict=True)]
    return found[0], found[1], found[2]


def least_step(q: Array) -> Array:
    """Return the least step (n) other than zero, inf where there is none."""
    steps = np.abs(np.diff(q, axis=0))
    return np.asarray(np.where(steps > 0, steps, np.inf).min(axis=0))
