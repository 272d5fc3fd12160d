"""From measured logs to segments: the noise and steps of the torque, and the knots that follow; ends of intervals."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.estimator import Problem
from dynident.estimators.maximum_likelihood.segment import Segment, Torques
from dynident.estimators.maximum_likelihood.trajectory import SplineTrajectory, graded_breaks
from dynident.estimators.notes import Averaged
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.motion.splines import NORMAL_95, least_noise, median_sigma, steady_noise, stretches
from dynident.regression import fitted_rows
from dynident.runtime import InputError, Note, Noun
from dynident.runtime.arrays import Array

MIN_NOISE = {"q": 1e-9, "tau": 1e-4}  # least noise, relative to the largest value: rounding and spline are hardly less
MIN_SAMPLES = 20  # samples of a recording


def has_sign(model: Model) -> bool:
    """Return whether a term of the model takes the sign of a velocity."""
    return any(term.discontinuous for term in model.terms)


def with_smooth_signs(model: Model, width: Array) -> Model:
    """Return the model with each sign(dq) replaced by tanh(dq / width), ``width`` (n) in rad/s or m/s by joint.

    The parameters and their order do not change. Terms that have a width or a dead band are not changed.
    """
    softened = (term.with_smooth_sign(width) if term.discontinuous else (term,) for term in model.terms)
    return replace(model, terms=tuple(itertools.chain.from_iterable(softened)))


FIRST_SPACING, SPACING_GROWTH = 0.25, 1.1  # first spacing of knots after a step, in samples, and its growth
TORQUE_KNOT_SPACING, TORQUE_KNOTS = 15, 4  # samples from one torque knot to the next after a step, and their number
LAG_SUMS = (1, 3, 10)  # numbers of autocorrelations that tell residuals from white ones
MEDIAN_SAMPLES = 9  # samples on each side whose medians tell a step from outliers
LINE_SAMPLES = 5  # samples on each side of a step that tell it from noise
# samples around a jump, of which each step touches ten, and the percentage of them that jump no more than is typical
NEARBY_SAMPLES, TYPICAL_PERCENTAGE = 81, 65
MAX_LOG_RANGE = 6.0  # of the search for the end of an interval, in the parameter's logarithm
ACCEPTED_RANGE = (0.6, 2.0)  # share of the limit between which the curve through the points known will do
MAX_TRIALS = 6
MIN_ROOT = 0.5  # root of the deviance below which a best fit says little about the curvature of the path


class Recordings(Noun):
    """The measurements.

    The logs, the steps of the torque (s) in each, the ``used_torques`` (N, n), the ``time_offset`` (s) of the
    positions, the ``usual_acceleration`` (n) of the joints, and the smoothed motions ``remembered`` with the
    memory of the model.
    """

    logs: tuple[Log, ...]
    steps: tuple[tuple[float, ...], ...]
    used_torques: tuple[NDArray[np.bool_] | None, ...]
    time_offset: float
    usual_acceleration: Array
    remembered: tuple[Motion, ...] = ()

    @cached_property
    def min_sigma_q(self) -> Array:
        """The least noise (n) of the positions that rounding and the splines allow to tell."""
        return np.asarray(np.max([least_noise(log.q, MIN_NOISE["q"]) for log in self.logs], axis=0))


def recordings(problem: Problem, rate: float | None, *, steps: bool) -> tuple[Recordings, list[Note]]:
    """Return the logs as measured, averaged down to about ``rate`` (Hz), and notes on this.

    Where the problem has no logs, the runs of usable samples of the motions are used.
    """
    notes: list[Note] = []
    remembered = problem.motions
    if problem.logs:
        logs = tuple(map(_bridge_excluded, problem.logs))
    else:
        logs, remembered = zip(*_usable_runs(problem), strict=True)
    used_torques: list[NDArray[np.bool_] | None] = [None] * len(logs)
    if len(logs) == len(problem.motions):
        used_torques = [fitted_rows(motion, problem.regression.min_speed) for motion in problem.motions]
    highest_rate = max((len(log) - 1) / float(np.ptp(log.t)) for log in logs)
    group = 1 if rate is None else int(np.ceil(highest_rate / rate))
    if 1 < group <= min(map(len, logs)) // MIN_SAMPLES:  # no log becomes too short
        means = [[_group_means(x, group) for x in (log.t, log.q, log.tau)] for log in logs]
        logs = tuple(Log(t, q, tau, log.joints, log.source) for (t, q, tau), log in zip(means, logs, strict=True))
        # an average counts only where all of its samples are used
        used_torques = [None if mask is None else _group_means(mask.astype(float), group) == 1 for mask in used_torques]
        notes.append(Averaged(group))
    sigma_tau = estimate_noise(logs)[1]
    step_times = tuple(torque_steps(log, sigma_tau) if steps else () for log in logs)
    acceleration = np.stack([10 * motion.ddq.std(axis=0) + 1e-9 for motion in problem.motions]).max(axis=0)
    return Recordings(
        tuple(logs), step_times, tuple(used_torques), problem.time_offset, acceleration, remembered
    ), notes


def _bridge_excluded(log: Log) -> Log:
    """Return a log with torques interpolated over excluded samples, whose steps and noise must not count."""
    if log.excluded is None or log.excluded.all():
        return log
    included = ~log.excluded
    columns = [np.interp(log.t, log.t[included], column[included]) for column in log.tau.T]
    return replace(log, tau=np.stack(columns, axis=1))


def estimate_noise(logs: Sequence[Log]) -> tuple[Array, Array]:
    """Return the standard deviations (n) of white noise in the positions and torques."""
    sizes = [len(log) for log in logs]
    deviations = (
        [steady_noise(getattr(log, name), min_noise) for log in logs] for name, min_noise in MIN_NOISE.items()
    )
    q, tau = (np.sqrt(np.average(np.square(x), axis=0, weights=sizes)) for x in deviations)
    return q, tau


def misfit(problem: Problem, theta: Array) -> Array:
    """Return the typical size (n) of the torque residuals of theta on the smoothed motions, robust to transients."""
    residuals = [
        (motion.tau - problem.model.torque(**motion.states(), theta=theta))[motion.mask] for motion in problem.motions
    ]
    return median_sigma(np.concatenate(residuals))


def _usable_runs(problem: Problem) -> list[tuple[Log, Motion]]:
    out = []
    for motion in problem.motions:
        for part in stretches(motion.mask):
            if part.stop - part.start >= MIN_SAMPLES:
                log = Log(motion.t[part], motion.q[part], motion.tau[part], motion.joints, motion.source)
                out.append((log, motion))
    if not out:
        raise InputError(f"maximum likelihood needs a run of at least {MIN_SAMPLES} usable samples.")
    return out


def _group_means(x: Array, group: int) -> Array:
    """Return the means of ``group`` neighbours of x (N, ...); the remainder at the end is dropped."""
    length = len(x) // group * group
    return np.asarray(x[:length].reshape(-1, group, *x.shape[1:]).mean(axis=1))


def torque_steps(log: Log, sigma_tau: Array, size: float = 8.0) -> tuple[float, ...]:
    """Return the times (s) at which a joint's torque steps: the first samples after the jumps.

    A jump is where straight lines through five samples on each side differ by ``size`` standard deviations of
    that difference, or ``size`` times as much as they typically do nearby, where the torque is fast. A step persists:
    the medians of nine samples on each side must also differ by half of the jump, which outliers cannot bring about.
    """
    from scipy.ndimage import percentile_filter

    N = len(log)
    if N < 4 * LINE_SAMPLES:
        return ()
    x = np.arange(LINE_SAMPLES)
    # weights of the value at the jump that a straight line through the samples after it extrapolates to
    weights = np.linalg.pinv(np.stack([np.ones(LINE_SAMPLES), x + 0.5], axis=1))[0]
    windows = np.lib.stride_tricks.sliding_window_view(log.tau, LINE_SAMPLES, axis=0)  # (N - 4, n, 5)
    jump = windows[LINE_SAMPLES:] @ weights - windows[:-LINE_SAMPLES] @ weights[::-1]
    deviations = np.abs(jump / (np.sqrt(2) * np.linalg.norm(weights) * sigma_tau))
    typical = percentile_filter(deviations, TYPICAL_PERCENTAGE, (NEARBY_SAMPLES, 1), mode="nearest")
    worst = (deviations / np.maximum(typical, 1.0)).max(axis=1)
    return tuple(
        float(log.t[k + LINE_SAMPLES])
        for k in np.flatnonzero(worst > size)
        if worst[k] == worst[max(k - LINE_SAMPLES, 0) : k + LINE_SAMPLES + 1].max()
        and _is_persistent(log.tau, int(k) + LINE_SAMPLES, jump[k])
    )


def _is_persistent(tau: Array, k: int, jump: Array) -> bool:
    """Return whether the joint with the largest jump (n) before sample k stays beyond half of it."""
    j = int(np.argmax(np.abs(jump)))
    change = np.median(tau[k : k + MEDIAN_SAMPLES, j]) - np.median(tau[max(k - MEDIAN_SAMPLES, 0) : k, j])
    return bool(change * np.sign(jump[j]) > 0.5 * abs(jump[j]))


def plan_segment(
    log: Log,
    steps: Sequence[float],
    spacing: float,
    sigma_tau: Array,
    time_offset: float = 0.0,
    used_torques: NDArray[np.bool_] | None = None,
    remembered: Motion | None = None,
    *,
    from_rest: bool,
) -> Segment:
    """Return the segment of a log whose knots are ``spacing`` samples apart, and dense after the steps.

    The start counts as a step where the motion begins ``from_rest``. After each step the torque is linear between
    torque knots, at most 15 samples apart and so close that the measured torque agrees. ``time_offset`` (s) is
    that of the positions; torques outside ``used_torques`` (N, n) count for nothing; ``remembered`` has the
    memory of the model.
    """
    h = float(np.median(np.diff(log.t)))
    begin, end = float(log.t[0]) - time_offset, float(log.t[-1]) - time_offset
    marks = [begin] if from_rest else []
    for step in sorted(steps):
        if step - max(marks, default=begin) > LINE_SAMPLES * h and end - step > LINE_SAMPLES * h:
            marks.append(step)
    # knots are dense after a step, where the motion is fast, and grow apart from there
    trajectory = SplineTrajectory(
        graded_breaks((begin, end), marks, FIRST_SPACING * h, spacing * h, SPACING_GROWTH),
        tuple(mark for mark in marks if mark > begin),
    )
    knot_groups = [_torque_knots(log, start, stop, h, sigma_tau) for start, stop in itertools.pairwise([*marks, end])]
    raw = Torques.of(log, time_offset, used_torques)
    torque_knots = tuple(knots for knots in knot_groups if len(knots))
    return Segment(log, trajectory, raw, raw, torque_knots, from_rest, time_offset, remembered)


def _torque_knots(log: Log, start: float, stop: float, h: float, sigma_tau: Array) -> Array:
    """Return the torque knots after a step, as far apart as the measured torque between them allows."""
    spacing = TORQUE_KNOT_SPACING
    duration = min(TORQUE_KNOT_SPACING * TORQUE_KNOTS * h, stop - start - h)
    while spacing >= 2:
        count = int(duration / (spacing * h) + 1e-9)
        if count:
            knots = np.asarray(start + np.arange(count + 1) * spacing * h)
            inside = (log.t >= start - 1e-12) & (log.t <= knots[-1] + 1e-12)
            hats = np.stack([np.interp(log.t[inside], knots, unit) for unit in np.eye(count + 1)], axis=1)
            tau = log.tau[inside] / sigma_tau
            residual = tau - hats @ np.linalg.lstsq(hats, tau, rcond=None)[0]
            degrees_of_freedom = tau.size - hats.shape[1] * tau.shape[1]
            # knots are near enough where the straight lines between them leave no more than noise (chi-square)
            if degrees_of_freedom < 1 or (residual**2).sum() < degrees_of_freedom + 3 * np.sqrt(2 * degrees_of_freedom):
                return knots
        # halve the distance until the lines fit, or no torque knots at all
        spacing //= 2
    return np.zeros(0)


def whiteness_probability(residuals: Array, coefficients: int) -> float:
    """Return the p-value of the test that residuals (N, n) are white, for the joint that looks worst.

    The means of the first, the first three and the first ten autocorrelations are compared with their standard
    deviations, 1 / sqrt(N lags). A fit with ``coefficients`` per joint makes residuals of white noise disagree:
    by about coefficients / N at lags shorter than the spacing of the knots, and by a half in the sum of all.
    """
    from scipy.special import ndtr

    N, n = residuals.shape
    x = residuals - residuals.mean(axis=0)
    power = np.maximum((x**2).sum(axis=0), 1e-300)
    total, worst = np.zeros(n), -np.inf
    for k in range(1, LAG_SUMS[-1] + 1):
        total += (x[k:] * x[:-k]).sum(axis=0) / power
        if k in LAG_SUMS:
            # the fit itself makes residuals of white noise disagree with their neighbours: allow for that
            worst = max(worst, float((total.max() + min(k * coefficients / N, 0.5)) * np.sqrt(N / k)))
    return float(min(1.0, len(LAG_SUMS) * n * ndtr(-worst)))


def crossing(root: Callable[[float], tuple[float, float]], size: float, side: int) -> float:
    """Return the share y of the estimate, 0 ... 1 for ``side`` -1 or above for 1, where the 95 % interval ends.

    ``root(y)`` is the root of the deviance at the share y, with the sign of ``side``, and its slope; at one it is
    zero, with the slope 1 / ``size``. Where it stays low, the last y is returned. A root of nan means that y
    cannot be evaluated: the end is not beyond.
    """
    aim, last = side * NORMAL_95, float(np.exp(side * MAX_LOG_RANGE))
    low, high = sorted((1.0, last))
    y = float(np.clip((1 + 0.5 * aim * size) ** 2 if side > 0 else np.exp(aim * size), low, high))
    points = [(0.0, 1.0, size)]  # the root, y, and its slope by the root
    for _ in range(MAX_TRIALS):
        trial_root, slope = root(y)
        if np.isnan(trial_root):
            # too far away to be evaluated: go back half of the way, on a logarithmic scale
            low, high = sorted((1.0, y))
            y = float(np.sqrt(y * points[-1][1]))
            continue
        points.append((trial_root, y, 1 / slope if slope > 0 else np.inf))
        previous, y = y, float(np.clip(_interpolate(points[-2], points[-1], aim), low, high))
        if ACCEPTED_RANGE[0] < trial_root / aim < ACCEPTED_RANGE[1] or previous == last:
            break
        # a curve far from the limit says little: keep the next trial within a factor of the last one
        y = float(np.clip(y, *sorted((previous**0.3, previous**2.5))))
        if y in (low, high) and y != last:  # where it has failed
            y = float(np.sqrt(y * previous))
    return y


def _interpolate(point: tuple[float, float, float], last_point: tuple[float, float, float], x: float) -> float:
    """Return y at x, interpolated or extrapolated from points (x, y, dy / dx).

    Between the points it is on the cubic through both. Beyond ``last_point`` it continues straight downwards or
    exponentially upwards: a curve that bends less has been passed by the first trial.
    """
    (a, ya, sa), (b, yb, sb) = point, last_point
    if (x - b) * (b - a) >= 0 or not np.isfinite(sb):
        change = (x - b) * sb
        return yb + change if change < 0 else yb * float(np.exp(min(change / yb, MAX_LOG_RANGE)))
    chord = (yb - ya) / (b - a)
    if not np.isfinite(sa):
        return ya + (x - a) * chord
    first_difference, last_difference = (chord - sa) / (b - a), (sb - chord) / (b - a)
    return ya + (x - a) * (sa + (x - a) * (first_difference + (x - b) * (last_difference - first_difference) / (b - a)))


def sweep_intervals(theta: Array, path: Sequence[tuple[float, Array]], covariance: Array, k: int) -> Array:
    """Return 95 % intervals (p, 2) of all parameters, from the profile likelihood of parameter k.

    ``path`` holds, besides the estimate ``theta`` (p), signed roots of the deviance and the best fits (p) with
    parameter k held there. The remaining likelihood at each point of the path is taken as normal: a parameter
    that follows k along a bent valley bends with it; one that does not has 1.96 standard errors. The path is a
    cubic whose slope at the estimate is that of the covariance; fits as likely as the estimate, but elsewhere,
    are left out.
    """
    # the part of each error that follows k, and what is left of it where k is known
    direction = covariance[:, k] / np.sqrt(covariance[k, k])
    conditional_std = np.sqrt(np.maximum(np.diag(covariance) - direction**2, 0.0))
    roots, powers = np.linspace(-NORMAL_95, NORMAL_95, 81)[:, None], np.array([2, 3])
    centre = theta + roots * direction
    informative = [pair for pair in path if abs(pair[0]) > MIN_ROOT]
    if informative:
        path_roots = np.array([[root] for root, _ in informative])
        deviation = np.array([best_fit for _, best_fit in informative]) - theta - path_roots * direction
        # the bend of the valley, as quadratic and cubic terms of the signed root
        centre += roots**powers @ np.linalg.lstsq(path_roots**powers, deviation, rcond=None)[0]
    # on the boundary of the likelihood region, what k does not use up is left for the rest
    reach = np.sqrt(NORMAL_95**2 - roots**2) * conditional_std
    return np.stack([(centre - reach).min(axis=0), (centre + reach).max(axis=0)], axis=1)
