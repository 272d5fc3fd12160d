"""What a free simulation goes through: the steps between samples, and what is given at these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.log import Controller, HasState, Motion

__all__ = ["FAR", "STEP", "Trace", "begun", "divided", "gaps_of", "held", "instants"]

Array = NDArray[np.float64]
STEP = 1e-3  # s, the longest step of the integration
MOST, FIT = 1000, 0.02  # steps of a drive between two samples, and how far they may be from a whole number
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


def instants(t: Array, period: float) -> Array:
    """Return times t (N), s, with those of a drive of this ``period`` (s) between them, in equal parts.

    Raises InputError where no whole number of periods, up to 1000, fits the usual step.
    """
    gaps = np.diff(t)
    usual = float(np.median(gaps)) if len(gaps) else 0.0
    times = usual / period if period > 0 and np.isfinite(period) else 0.0
    parts = min(max(round(times), 1), MOST)
    if abs(times - parts) > FIT * parts:
        raise InputError(
            f"period = {period:g} s does not fit the {usual:.6g} s from sample to sample; give a whole part of that, "
            f"such as {usual / parts:.6g}, or leave it out."
        )
    each = np.maximum(np.round(gaps / usual), 1).astype(int) * parts
    ends = np.concatenate(([0], np.cumsum(each)))
    return np.asarray(np.interp(np.arange(ends[-1] + 1), ends, t))


def begun(controller: Controller, motion: Motion, row: NDArray[np.intp]) -> Array:
    """Return the state (m) of a controller before the samples (K) of a motion, none where it has no state."""
    if not isinstance(controller, HasState):
        return np.zeros(0)
    t, k = motion.t[row[:2]], row[0]
    return controller.begin(float(t[0]), float(t[1] - t[0]), motion.q[k], motion.dq[k], motion.tau[k])
