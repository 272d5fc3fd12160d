"""Dynamics of an arm's deviation from its smoothed motion over one step, driven by the torque.

Friction and mass are evaluated at the measured motion, so that neither a sticking joint nor stiff friction
can make a prediction diverge; the stiff part is integrated by the exact matrix exponential.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.estimator import Problem
from dynident.estimators.maximum_likelihood import has_sign, with_smooth_signs
from dynident.estimators.maximum_likelihood.plan import estimate_noise
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.motion.splines import stretches
from dynident.regression import fitted_rows
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

SERIES_ORDER = 6  # of the exponential's series
MAX_SERIES_NORM, MAX_DOUBLINGS = 0.25, 40  # size of what is put into the series; doublings at most
PIECE_STEPS = 125  # steps of a piece
MIN_PIECE_STEPS = 12  # steps of one
UNUSED_NOISE = 100.0  # times the noise, of a torque that is not to be fitted


class FilterStep(Noun):
    """The input of B steps of length ``step`` (B) in s: the mean smoothed ``motion`` (3, B, n), the mean torque
    ``residual`` (B, n) that the parameters leave unexplained, and its standard deviation ``noise`` (B, n)."""

    step: Array
    motion: Array
    residual: Array
    noise: Array


class FilterSeries(Noun):
    """B pieces of K steps of length ``step`` (B) s.

    ``offset`` (B, K + 1, n): measured minus smoothed positions. ``mean``, ``noise`` (B, K, n): the mean torque
    residual of each step, and its standard deviation. ``active`` (B, K): whether the step exists. ``sigma`` (n):
    noise of the positions. ``motion`` (3, B, K, n): the means of the smoothed q and dq over each step, and the
    mean acceleration.
    """

    step: Array
    offset: Array
    mean: Array
    noise: Array
    active: NDArray[np.bool_]
    sigma: Array
    motion: Array

    def filter_step(self, k: int) -> FilterStep:
        """Return the k-th step of the pieces that have it."""
        on = self.active[:, k]
        return FilterStep(self.step[on], self.motion[:, on, k], self.mean[on, k], self.noise[on, k])


def series_of(
    problem: Problem, samples: int, torque: Array, uncertain: tuple[Array, ...], residuals: tuple[Array, ...]
) -> FilterSeries:
    """Cut all motions into pieces, of at most ``samples`` steps per motion.

    ``torque`` (n) is the noise of a torque sample, ``uncertain`` (N, n) an additional uncertainty of the torque
    of each motion, and ``residuals`` (N, n) the torque that the parameters leave unexplained; for exact data it
    is zero, however long a step is.

    Raises InputError where no piece is long enough.
    """
    pieces = [
        piece
        for k in range(len(problem.motions))
        for piece in _cut_pieces(problem, k, samples, _torque_variance(problem, k, torque, uncertain[k]), residuals[k])
    ]
    if not pieces:
        raise InputError(f"the Kalman filter needs a run of at least {MIN_PIECE_STEPS} usable samples; record longer.")
    longest = max(len(piece[2]) for piece in pieces)
    step, offset, mean, noise, *motion = zip(*pieces, strict=True)
    active = np.stack([np.arange(longest) < len(piece) for piece in mean])

    # shorter pieces are padded; their surplus steps are not active
    def pad(x: tuple[Array, ...], length: int) -> Array:
        return np.stack([np.pad(piece, ((0, length - len(piece)), (0, 0)), "edge") for piece in x])

    a, b = (pad(piece, longest) for piece in (mean, noise))
    smooth = np.stack([pad(piece, longest) for piece in motion])
    return FilterSeries(np.array(step), pad(offset, longest + 1), a, b, active, _position_noise(problem), smooth)


def group_size(motion: Motion, samples: int) -> int:
    """Return how many samples of a motion are joined to one step, for at most ``samples`` steps."""
    return max(1, -(-int(motion.mask.sum()) // samples))


def _position_noise(problem: Problem) -> Array:
    """Return the noise (n) of the measured positions, at least the rms that the smoother removed."""
    logs = problem.logs or tuple(Log(motion.t, motion.q, motion.tau, motion.joints) for motion in problem.motions)
    residuals = [(_measured_positions(problem, k) - motion.q)[motion.mask] for k, motion in enumerate(problem.motions)]
    return np.asarray(np.maximum(estimate_noise(logs)[0], np.sqrt(np.square(np.concatenate(residuals)).mean(axis=0))))


def _measured_positions(problem: Problem, k: int) -> Array:
    """Return the positions (N, n) as measured, at the times of the torque."""
    motion = problem.motions[k]
    if len(problem.logs) != len(problem.motions) or len(problem.logs[k]) != len(motion):
        return motion.q
    log = problem.logs[k]
    if not problem.time_offset:
        return log.q
    # the log's stamps are late by the time offset: carry the residual over, not the position itself
    offset = log.q - motion.shift(-problem.time_offset).q
    nearest = np.searchsorted(log.t, motion.t + problem.time_offset).clip(0, len(log) - 1)
    return np.asarray(motion.q + offset[nearest])


def _torque_variance(problem: Problem, k: int, torque: Array, uncertain: Array) -> Array:
    """Return the variance (N, n) of the torques of a motion, from the noise of a sample and their uncertainty."""
    motion = problem.motions[k]
    fitted_mask = fitted_rows(motion, problem.regression.min_speed)
    # torques that are not to be fitted keep their place, with so much noise that they count for nothing
    unused_noise = np.zeros(motion.q.shape) if fitted_mask is None else UNUSED_NOISE * torque * ~fitted_mask
    return np.asarray(np.square(torque) + np.square(uncertain) + np.square(unused_noise))


def _cut_pieces(problem: Problem, k: int, samples: int, variance: Array, residual: Array) -> list[tuple[Any, ...]]:
    """Return step, position offsets, mean and noise of the torque, and smoothed motion of each piece of a motion."""
    motion = problem.motions[k]
    offset = _measured_positions(problem, k) - motion.q
    group, h = group_size(motion, samples), float(np.diff(motion.t).mean())
    out: list[tuple[Any, ...]] = []
    for stretch in stretches(motion.mask):
        steps = (stretch.stop - 1 - stretch.start) // group
        # cut a stretch into pieces of nearly equal length: a short remainder would be lost
        count = max(1, round(steps / PIECE_STEPS))
        edges = stretch.start + group * (steps * np.arange(count + 1) // count)
        for a, b in pairwise(edges):
            if (b - a) // group >= MIN_PIECE_STEPS:
                rows, at = slice(a, b + 1), np.arange(0, b - a + 1, group)
                mean = _trapezoid_means(residual[rows], at, group)
                noise = np.sqrt(_trapezoid_means(variance[rows], at, group) / group)
                smooth = (_trapezoid_means(quantity[rows], at, group) for quantity in (motion.q, motion.dq))
                acceleration = np.diff(motion.dq[rows][at], axis=0) / (group * h)
                out.append((group * h, offset[rows][at], mean, noise, *smooth, acceleration))
    return out


def _trapezoid_means(x: Array, at: NDArray[np.intp], group: int) -> Array:
    """Return the mean of x (N, n) between the samples ``at``, by trapezoids."""
    total = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum((x[1:] + x[:-1]) / 2, axis=0)])
    return np.asarray(np.diff(total[at], axis=0) / group)


def smooth_model(problem: Problem, theta: Array, step: float) -> tuple[Model, tuple[float, ...], tuple[Array, ...]]:
    """Return the model with smooth signs, their widths (n), and the uncertainty of the torque (N, n) of each motion.

    The uncertainty is that of friction within a step: half its second difference by the velocity, and the effect
    of smoothing. The width is the change of the velocity in a typical step.
    """
    model, motions = problem.model, problem.motions
    rms_acceleration = np.max([np.sqrt(np.square(motion.ddq[motion.mask]).mean(axis=0)) for motion in motions], axis=0)
    fastest = np.max([np.abs(motion.dq[motion.mask]).max(axis=0) for motion in motions], axis=0)
    width = np.maximum(step * rms_acceleration, np.where(fastest > 0, 1e-3 * fastest, 1.0))
    smooth, widths = (with_smooth_signs(model, width), tuple(width.tolist())) if has_sign(model) else (model, ())
    uncertainty = []
    for motion in motions:
        # half the second difference of friction across a step tells how far its mean may be off
        torques = [model.torque(motion.q, motion.dq + side * width, motion.ddq, theta) for side in (-1.0, 0.0, 1.0)]
        smoothing_error = smooth.torque(motion.q, motion.dq, motion.ddq, theta) - torques[1]
        uncertainty.append(np.hypot((torques[0] - 2 * torques[1] + torques[2]) / 2, smoothing_error))
    return smooth, widths, tuple(uncertainty)


class Dynamics(Noun):
    """A ``model`` with parameters theta = ``theta`` (p) + ``directions`` (p, r) a.

    A state (L = 2 n + r) holds the deviations of q and dq from the smoothed motion, and a. ``moment_noise`` is
    the noise of the torque's first moment over a step, as a multiple of step^2 and of the noise of its mean; it
    moves q, not dq.
    """

    model: Model
    theta: Array
    directions: Array
    moment_noise: float

    @property
    def joint_count(self) -> int:
        """The number n of joints."""
        return len(self.model.joints)

    def linearise(self, step: FilterStep) -> tuple[Array, Array, Array]:
        """Return F (B, L, L), G (B, L, 2 n) and c (B, L) of the step, x -> F x + c, linearised at the mean motion.

        G are the derivatives by the mean torque and by its first moment. Linearising at the motion that the noisy
        torque produces would overstate the information: the regressor would contain noise.
        """
        n, r, motion = self.joint_count, self.directions.shape[1], step.motion
        mass = self.model.mass_matrix(motion[0], self.theta)
        partials = self.model.partials(motion[0], motion[1], motion[2], self.theta)
        regressor = self.model.regressor(*motion) @ self.directions
        # the last torque column is what the parameters leave unexplained: it gives the constant part c
        unit = np.broadcast_to(np.eye(n), mass.shape)
        right_sides = np.concatenate([-partials.q, -partials.dq, -regressor, unit, step.residual[..., None]], axis=2)
        solution: Array = np.asarray(np.linalg.solve(mass, right_sides), dtype=np.float64)
        transition, integral = _matrix_exponential(step.step, solution[:, :, : 2 * n])
        response = integral[:, :, n:] @ solution[:, :, 2 * n :]
        F = np.tile(np.eye(2 * n + r), (len(mass), 1, 1))
        F[:, : 2 * n, : 2 * n], F[:, : 2 * n, 2 * n :] = transition, response[:, :, :r]
        torque_response = np.concatenate([response[:, :, r:], np.zeros((len(mass), r, n + 1))], axis=1)
        # noise of the torque's first moment moves the position within a step, but not the velocity
        moment = np.zeros((len(mass), 2 * n + r, n))
        moment[:, :n] = self.moment_noise * np.square(step.step)[:, None, None] * solution[:, :, 2 * n + r : -1]
        return F, np.concatenate([torque_response[:, :, :n], moment], axis=2), torque_response[:, :, n]


def predict_state(dynamics: Dynamics, step: FilterStep, x: Array, S: Array) -> tuple[Array, Array]:
    """Return the state and S after a step, linearised at the smoothed motion."""
    F, G, c = dynamics.linearise(step)
    noise = G * np.tile(step.noise, 2)[:, None]
    return (F @ x[..., None])[..., 0] + c, lower_root(np.concatenate([F @ S, noise], axis=2))


def lower_root(rows: Array) -> Array:
    """Return S (B, L, L), lower triangular, with S S' = A A' for ``rows`` A (B, L, K)."""
    upper = np.asarray(np.linalg.qr(np.swapaxes(rows, 1, 2), mode="r"))
    return np.asarray(np.swapaxes(upper, 1, 2))


def correct_state(x: Array, S: Array, y: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Update states x (B, L) and roots S (B, L, L) by measurements y (B, n) of their first n entries.

    ``sigma`` (n) are the standard deviations of the measurements. Also return the normalised innovations (B, n),
    which are white with variance one where the filter is right.
    """
    n, size = y.shape[1], x.shape[1]
    # one QR decomposition of [[R, C S], [0, S]] gives innovation deviation, gain and new root without forming P
    pre_array = np.zeros((len(x), n + size, n + size))
    pre_array[:, range(n), range(n)] = sigma
    pre_array[:, :n, n:], pre_array[:, n:, n:] = S[:, :n], S
    post_array = lower_root(pre_array)
    innovations: Array = np.asarray(np.linalg.solve(post_array[:, :n, :n], (y - x[:, :n])[..., None]), dtype=np.float64)
    return x + (post_array[:, n:, :n] @ innovations)[..., 0], post_array[:, n:, n:], innovations[..., 0]


def _matrix_exponential(step: Array, rates: Array) -> tuple[Array, Array]:
    """Return exp(A h) and the integral of exp(A s) from 0 to h, (B, 2 n, 2 n).

    ``rates`` (B, n, 2 n) are the last rows of A; the first ones are [0, I].
    """
    n = rates.shape[1]
    A = np.zeros((len(rates), 2 * n, 2 * n))
    A[:, :n, n:], A[:, n:] = np.eye(n), rates
    norm = float((np.abs(A).sum(axis=2).max(axis=1) * step).max(initial=0.0))
    # scale A h down until the truncated series is exact to rounding, then square it up again
    doublings = (
        int(np.clip(np.ceil(np.log2(max(norm, MAX_SERIES_NORM) / MAX_SERIES_NORM)), 0, MAX_DOUBLINGS))
        if np.isfinite(norm)
        else 0
    )
    h = (step / 2.0**doublings)[:, None, None]
    F = np.tile(np.eye(2 * n), (len(A), 1, 1))
    integral, power = F.copy(), F.copy()
    for k in range(1, SERIES_ORDER + 1):
        power = power @ A * (h / k)
        F, integral = F + power, integral + power / (k + 1)
    integral = integral * h
    for _ in range(doublings):
        F, integral = F @ F, integral + F @ integral
    return F, integral
