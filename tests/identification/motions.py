"""Motions in closed form."""

import numpy as np
from numpy.typing import ArrayLike

from dynident.runtime.arrays import Array


def sines(t: Array, size: ArrayLike, rate: ArrayLike, phase: ArrayLike = 0.0) -> tuple[Array, Array, Array]:
    """Return q, dq, ddq (N, n) of sums of sines, whose sizes, rates (rad/s) and phases are (K, n)."""
    size, rate = np.asarray(size), np.asarray(rate)
    angle = t[:, None, None] * rate + phase
    q, dq, ddq = (np.sum(size * rate**k * np.sin(angle + k * np.pi / 2), axis=1) for k in range(3))
    return q, dq, ddq
