"""What a free simulation goes through: the steps between samples, and what is given at these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.log import Controller, HasState, Motion

__all__ = ["FAR", "STEP", "Trace", "begun", "divided", "gaps_of", "held"]

Array = NDArray[np.float64]
STEP = 1e-3  # s, the longest step of the integration
FAR = 1e6  # rad or m: a simulation beyond this has diverged


@dataclass(frozen=True, eq=False)
class Trace:
    """All S steps of B pieces of K samples: their lengths ``h`` (S), s, and the states between them.

    ``begins`` (S + 1) is the sample that a step begins with, or -1; ``q``, ``dq`` (S + 1, B, n) rad or m, and per s;
    ``tau`` (K, B, n) N m or N is applied from a sample on; ``states`` (K, m) of the controller are before it.
    """

    h: Array
    begins: NDArray[np.intp]
    q: Array
    dq: Array
    tau: Array
    states: Array

    __repr__ = brief

    @property
    def samples(self) -> NDArray[np.intp]:
        """The steps (K) that begin with a sample, after the last step the end."""
        return np.flatnonzero(self.begins >= 0)


def divided(lengths: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the lengths h (S) of the steps between samples so far apart (K - 1), s, and with which sample each begins.

    They are equal parts of at most ``STEP``; -1 (S + 1) is none, and the last begins with the end.
    """
    parts = np.maximum(np.ceil(lengths / STEP - 1e-3), 1).astype(int)
    begins = np.full(parts.sum() + 1, -1)
    begins[np.cumsum(np.append(0, parts))] = np.arange(len(lengths) + 1)
    return np.repeat(lengths / parts, parts), begins


def held(motion: Motion, rows: NDArray[np.intp]) -> Array:
    """Return the measured torques (K, B, n) from samples ``rows`` (B, K) on, the means of these and the next ones."""
    tau = motion.tau[rows].swapaxes(0, 1)
    return np.concatenate((0.5 * (tau[:-1] + tau[1:]), tau[-1:]))


def gaps_of(t: Array) -> Array:
    """Return the time (K) before each sample, s; before the first that after it."""
    lengths = np.diff(t)
    return np.append(lengths[:1], lengths)


def begun(controller: Controller, motion: Motion, row: NDArray[np.intp]) -> Array:
    """Return the state (m) of a controller before the samples (K) of a motion, none where it has no state."""
    if not isinstance(controller, HasState):
        return np.zeros(0)
    t, k = motion.t[row[:2]], row[0]
    return controller.begin(float(t[0]), float(t[1] - t[0]), motion.q[k], motion.dq[k], motion.tau[k])
