"""From a log to a segment: the noise of its channels, steps of its torque, and the knots that follow from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.likelihood.segment import Segment
from dynident.likelihood.trajectory import Trajectory, graded
from dynident.log import Log

__all__ = ["noise", "plan", "steps_of", "whiteness"]

Array = NDArray[np.float64]
FINE, GROWTH = 0.25, 1.1  # first spacing of knots after a step, in samples, and its growth
CORNER, CORNERS = 15, 4  # samples from one torque knot to the next after a step, and their number
SIDE = 5  # samples on each side of a step that tell it from noise
ROUNDING = 1e-12  # least noise, relative to the size of the signal


def noise(x: Array, order: int = 4) -> Array:
    """Return the noise's standard deviation (n) of evenly sampled x (N, n), from the median of its differences.

    The median does not see the few samples after a step. White noise is assumed.
    """
    coefficients = np.array([1.0])
    for _ in range(order):
        coefficients = np.convolve(coefficients, [1.0, -1.0])
    left = np.abs(np.diff(x, order, axis=0))
    found = 1.4826 * np.median(left, axis=0) / np.linalg.norm(coefficients)
    return np.asarray(np.maximum(found, ROUNDING * np.maximum(np.abs(x).max(axis=0), 1e-100)))


def steps_of(log: Log, sigma_tau: Array, size: float = 8.0) -> tuple[float, ...]:
    """Return the times (s) at which a joint's torque steps: the first samples after the jumps.

    A jump is where straight lines through five samples on each side differ by ``size`` standard deviations of that
    difference, more than they do nearby.
    """
    N = len(log)
    if N < 4 * SIDE:
        return ()
    x = np.arange(SIDE)
    ahead = np.linalg.pinv(np.stack([np.ones(SIDE), x + 0.5], axis=1))[0]
    view = np.lib.stride_tricks.sliding_window_view(log.tau, SIDE, axis=0)  # (N - 4, n, 5)
    jump = np.abs(view[SIDE:] @ ahead - view[:-SIDE] @ ahead[::-1]) / (np.sqrt(2) * np.linalg.norm(ahead) * sigma_tau)
    worst = jump.max(axis=1)
    peaks = [k for k in np.flatnonzero(worst > size) if worst[k] == worst[max(k - SIDE, 0) : k + SIDE + 1].max()]
    return tuple(float(log.t[k + SIDE]) for k in peaks)


def plan(log: Log, steps: Sequence[float], spacing: float, *, rest: bool, corner: float = CORNER) -> Segment:
    """Return the segment of a log whose knots are ``spacing`` samples apart, and dense after its start and the steps.

    ``corner`` is the distance (samples) of the torque's knots after a step.
    """
    h = float(np.median(np.diff(log.t)))
    begin, end = float(log.t[0]), float(log.t[-1])
    room = (CORNER * CORNERS + SIDE) * h
    kept = [begin]
    for step in sorted(steps):
        if step - kept[-1] > SIDE * h and end - step > SIDE * h:
            kept.append(step)
    marks = tuple(kept)
    trajectory = Trajectory(graded(begin, end, marks, FINE * h, spacing * h, GROWTH), marks[1:])
    knots = []
    for left, right in zip(marks, (*marks[1:], end), strict=True):
        count = int(min(room, right - left - h) / (corner * h))
        if count:
            knots.append(left + np.arange(count + 1) * corner * h)
    return Segment(log, trajectory, tuple(knots), rest)


def whiteness(left: Array, lags: int = 10) -> float:
    """Return the probability (Ljung and Box) that residuals (N, n) as correlated as the worst joint's are white."""
    from scipy.special import gammaincc

    N, n = left.shape
    x = left - left.mean(axis=0)
    power = np.maximum((x**2).sum(axis=0), 1e-300)
    total = np.zeros(n)
    for k in range(1, min(lags, N - 2) + 1):
        total += ((x[k:] * x[:-k]).sum(axis=0) / power) ** 2 / (N - k)
    return float(np.min(gammaincc(lags / 2, N * (N + 2) * total / 2)) * n)
