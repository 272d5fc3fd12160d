"""The input of the filter: positions, torques and their noise in pieces of steps, and the friction that they allow."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.estimators.estimator import Problem
from dynident.estimators.maximum_likelihood.friction import has_sign, with_smooth_signs
from dynident.estimators.maximum_likelihood.measured import usual_noise
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.regression import fitted_rows, stretches

__all__ = ["Series", "grouping", "series_of", "smooth_model"]

Array = NDArray[np.float64]
PIECE = 125  # steps of a piece
FEWEST = 12  # steps of one
UNUSED = 100.0  # times the noise, of a torque that is not to be fitted


@dataclass(frozen=True, eq=False)
class Series:
    """B pieces of K steps of ``step`` (B) s: what the measured positions differ from the smoothed ones by, ``off``
    (B, K + 1, n), the ``mean`` torque (B, K, n) of each step that parameters leave, its standard deviation ``noise``
    (B, K, n); ``used`` (B, K) is whether a step is there; ``sigma`` (n) is the noise of the positions. ``motion``
    (3, B, K, n) is the mean of the smoothed q and dq over each step, and the change of dq over its time.
    """

    step: Array
    off: Array
    mean: Array
    noise: Array
    used: NDArray[np.bool_]
    sigma: Array
    motion: Array

    __repr__ = brief


def series_of(
    problem: Problem, samples: int, torque: Array, uncertain: tuple[Array, ...], left: tuple[Array, ...]
) -> Series:
    """Return the pieces, at most ``samples`` steps of each motion. ``torque`` (n) is the noise of a sample,
    ``uncertain`` (N, n), for each motion, what its torque is uncertain by besides, and ``left`` (N, n) what parameters
    leave of it: taken at the samples, it is zero for exact data, however long a step is.

    Raises InputError where no piece is long enough.
    """
    found = [
        one for k in range(len(problem.motions)) for one in _pieces(problem, k, samples, torque, uncertain[k], left[k])
    ]
    if not found:
        raise InputError(f"the Kalman filter needs a run of at least {FEWEST} usable samples; record longer.")
    most = max(len(one[2]) for one in found)
    step, off, mean, noise, *motion = zip(*found, strict=True)
    used = np.stack([np.arange(most) < len(one) for one in mean])

    def padded(x: tuple[Array, ...], length: int) -> Array:
        return np.stack([np.pad(one, ((0, length - len(one)), (0, 0)), "edge") for one in x])

    a, b = (padded(one, most) for one in (mean, noise))
    smooth = np.stack([padded(one, most) for one in motion])
    return Series(np.array(step), padded(off, most + 1), a, b, used, _sigma(problem), smooth)


def grouping(motion: Motion, samples: int) -> int:
    """Return how many samples of a motion make a step, of which there are ``samples`` at most."""
    return max(1, -(-int(motion.mask.sum()) // samples))


def _sigma(problem: Problem) -> Array:
    """Return the noise (n) of the measured positions, at least what the smoother took for it."""
    logs = problem.logs or tuple(Log(one.t, one.q, one.tau, one.joints) for one in problem.motions)
    left = [(_measured(problem, k) - one.q)[one.mask] for k, one in enumerate(problem.motions)]
    return np.asarray(np.maximum(usual_noise(logs)[0], np.sqrt(np.square(np.concatenate(left)).mean(axis=0))))


def _measured(problem: Problem, k: int) -> Array:
    """Return the positions (N, n) as measured, at the times of the torque."""
    motion = problem.motions[k]
    if len(problem.logs) != len(problem.motions) or len(problem.logs[k]) != len(motion):
        return motion.q
    log = problem.logs[k]
    if not problem.time_offset:
        return log.q
    left = log.q - motion.shifted(-problem.time_offset).q
    at = np.searchsorted(log.t, motion.t + problem.time_offset).clip(0, len(log) - 1)
    return np.asarray(motion.q + left[at])


def _pieces(
    problem: Problem, k: int, samples: int, torque: Array, uncertain: Array, left: Array
) -> list[tuple[Any, ...]]:
    """Return the step, the positions off the smoothed ones, mean and noise of the torque, and the smoothed motion, of
    each piece."""
    motion = problem.motions[k]
    off = _measured(problem, k) - motion.q
    kept = fitted_rows(motion, problem.regression.min_speed)
    unused = np.zeros(motion.q.shape) if kept is None else UNUSED * torque * ~kept
    noise2 = np.square(torque) + np.square(uncertain) + np.square(unused)
    group, h = grouping(motion, samples), float(np.diff(motion.t).mean())
    out: list[tuple[Any, ...]] = []
    for part in stretches(motion.mask):
        steps = (part.stop - 1 - part.start) // group
        count = max(1, round(steps / PIECE))
        edges = part.start + group * (steps * np.arange(count + 1) // count)
        for a, b in pairwise(edges):
            if (b - a) // group >= FEWEST:
                rows, at = slice(a, b + 1), np.arange(0, b - a + 1, group)
                mean = _mean(left[rows], at, group)
                noise = np.sqrt(_mean(noise2[rows], at, group) / group)
                smooth = (_mean(one[rows], at, group) for one in (motion.q, motion.dq))
                rate = np.diff(motion.dq[rows][at], axis=0) / (group * h)
                out.append((group * h, off[rows][at], mean, noise, *smooth, rate))
    return out


def _mean(x: Array, at: NDArray[np.intp], group: int) -> Array:
    """Return the mean of x (N, n) between the samples ``at``, by trapezoids."""
    total = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum((x[1:] + x[:-1]) / 2, axis=0)])
    return np.asarray(np.diff(total[at], axis=0) / group)


def smooth_model(problem: Problem, theta: Array, step: float) -> tuple[Model, tuple[float, ...], tuple[Array, ...]]:
    """Return the model with smooth signs of the velocities, their widths (n), and what the torque (N, n) of each motion
    is uncertain by where friction bends within a step: half its second difference by the velocity, and what is smooth.

    The width is the change of the velocity in a usual step.
    """
    model, motions = problem.model, problem.motions
    usual = np.max([np.sqrt(np.square(one.ddq[one.mask]).mean(axis=0)) for one in motions], axis=0)
    fastest = np.max([np.abs(one.dq[one.mask]).max(axis=0) for one in motions], axis=0)
    width = np.maximum(step * usual, np.where(fastest > 0, 1e-3 * fastest, 1.0))
    smooth, widths = (with_smooth_signs(model, width), tuple(width.tolist())) if has_sign(model) else (model, ())
    bent = []
    for one in motions:
        some = [model.torque(one.q, one.dq + side * width, one.ddq, theta) for side in (-1.0, 0.0, 1.0)]
        changed = smooth.torque(one.q, one.dq, one.ddq, theta) - some[1]
        bent.append(np.hypot((some[0] - 2 * some[1] + some[2]) / 2, changed))
    return smooth, widths, tuple(bent)
