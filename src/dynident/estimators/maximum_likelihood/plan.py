"""From a log to a segment: steps of its torque, and the knots that follow from them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.maximum_likelihood.segment import Segment
from dynident.estimators.maximum_likelihood.torques import Torques
from dynident.estimators.maximum_likelihood.trajectory import Trajectory, graded
from dynident.log import Log, Motion

__all__ = ["plan", "steps_of", "whiteness"]

Array = NDArray[np.float64]
FINE, GROWTH = 0.25, 1.1  # first spacing of knots after a step, in samples, and its growth
CORNER, CORNERS = 15, 4  # samples from one torque knot to the next after a step, and their number
SUMS = (1, 3, 10)  # numbers of autocorrelations that tell residuals from white ones
LONG = 9  # samples on each side whose medians tell a step from outliers
SIDE = 5  # samples on each side of a step that tell it from noise


def steps_of(log: Log, sigma_tau: Array, size: float = 8.0) -> tuple[float, ...]:
    """Return the times (s) at which a joint's torque steps: the first samples after the jumps.

    A jump is where straight lines through five samples on each side differ by ``size`` standard deviations of that
    difference, more than they do nearby. A step persists: the medians of nine samples on each side must differ by half
    of it, too, which outliers cannot bring about.
    """
    N = len(log)
    if N < 4 * SIDE:
        return ()
    x = np.arange(SIDE)
    ahead = np.linalg.pinv(np.stack([np.ones(SIDE), x + 0.5], axis=1))[0]
    view = np.lib.stride_tricks.sliding_window_view(log.tau, SIDE, axis=0)  # (N - 4, n, 5)
    jump = (view[SIDE:] @ ahead - view[:-SIDE] @ ahead[::-1]) / (np.sqrt(2) * np.linalg.norm(ahead) * sigma_tau)
    worst = np.abs(jump).max(axis=1)
    peaks = [k for k in np.flatnonzero(worst > size) if worst[k] == worst[max(k - SIDE, 0) : k + SIDE + 1].max()]
    height = np.sqrt(2) * np.linalg.norm(ahead) * sigma_tau
    return tuple(float(log.t[k + SIDE]) for k in peaks if _persists(log.tau, int(k) + SIDE, jump[k] * height))


def _persists(tau: Array, k: int, jump: Array) -> bool:
    """Return whether the joint with the largest jump (n) before sample k stays beyond it."""
    j = int(np.argmax(np.abs(jump)))
    before, after = (np.median(part) for part in (tau[max(k - LONG, 0) : k, j], tau[k : k + LONG, j]))
    return bool((after - before) * np.sign(jump[j]) > 0.5 * abs(jump[j]))


def plan(
    log: Log,
    steps: Sequence[float],
    spacing: float,
    sigma_tau: Array,
    *,
    rest: bool,
    time_offset: float = 0.0,
    used: NDArray[np.bool_] | None = None,
    remembered: Motion | None = None,
) -> Segment:
    """Return the segment of a log whose knots are ``spacing`` samples apart, and dense after the steps.

    The start is a step where the motion begins from ``rest``. After each step the torque is linear between torque
    knots, 15 samples apart or so near that the measured torque agrees. ``time_offset`` (s) of the positions; torques
    that are not ``used`` (N, n) count for nothing; ``remembered`` has the memory of the model.
    """
    h = float(np.median(np.diff(log.t)))
    begin, end = float(log.t[0]) - time_offset, float(log.t[-1]) - time_offset
    marks = [begin] if rest else []
    for step in sorted(steps):
        if step - max(marks, default=begin) > SIDE * h and end - step > SIDE * h:
            marks.append(step)
    trajectory = Trajectory(
        graded(begin, end, marks, FINE * h, spacing * h, GROWTH), tuple(mark for mark in marks if mark > begin)
    )
    found = [_corners(log, left, right, h, sigma_tau) for left, right in itertools.pairwise([*marks, end])]
    raw = Torques.of(log, time_offset, used)
    torque_knots = tuple(knots for knots in found if len(knots))
    return Segment(log, trajectory, raw, raw, torque_knots, rest, time_offset, remembered)


def _corners(log: Log, left: float, right: float, h: float, sigma_tau: Array) -> Array:
    """Return the torque knots after a step, as far apart as the measured torque between them allows."""
    corner = CORNER
    room = min(CORNER * CORNERS * h, right - left - h)
    while corner >= 2:
        count = int(room / (corner * h) + 1e-9)
        if count:
            knots = np.asarray(left + np.arange(count + 1) * corner * h)
            inside = (log.t >= left - 1e-12) & (log.t <= knots[-1] + 1e-12)
            hats = np.stack([np.interp(log.t[inside], knots, unit) for unit in np.eye(count + 1)], axis=1)
            tau = log.tau[inside] / sigma_tau
            left_over = tau - hats @ np.linalg.lstsq(hats, tau, rcond=None)[0]
            free = tau.size - hats.shape[1] * tau.shape[1]
            if free < 1 or (left_over**2).sum() < free + 3 * np.sqrt(2 * free):
                return knots
        corner //= 2
    return np.zeros(0)


def whiteness(left: Array, taken: int) -> float:
    """Return the probability that residuals (N, n) whose neighbours agree as much as the worst joint's are white.

    The means of the first, the first three and the first ten autocorrelations are compared with their standard
    deviations, 1 / sqrt(N lags). A fit with
    ``taken`` coefficients per joint makes residuals of white noise disagree: by about taken / N at lags shorter than
    its knots' spacing, and by a half in the sum of all.
    """
    from scipy.special import ndtr

    N, n = left.shape
    x = left - left.mean(axis=0)
    power = np.maximum((x**2).sum(axis=0), 1e-300)
    total, worst = np.zeros(n), -np.inf
    for k in range(1, SUMS[-1] + 1):
        total += (x[k:] * x[:-k]).sum(axis=0) / power
        if k in SUMS:
            worst = max(worst, float((total.max() + min(k * taken / N, 0.5)) * np.sqrt(N / k)))
    return float(min(1.0, len(SUMS) * n * ndtr(-worst)))
