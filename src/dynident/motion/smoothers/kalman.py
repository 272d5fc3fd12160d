"""Kalman smoothing: the position as an integrated Wiener process, noise and process by maximum likelihood."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, inf, isfinite, log, log2, nan
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from dynident.motion.log import Log, Motion
from dynident.motion.smoothers.smoother import BY_JOINT, Smoother, at_rest, ends_mask, make_motion
from dynident.motion.splines import Fixed, Rule, smooth
from dynident.motion.splines.banded import EPS, TINY, IllConditionedError
from dynident.motion.splines.quintic import QuinticSolution, QuinticSystem
from dynident.motion.splines.search import SplineSearch, likelihood_criterion, reml_criterion, search_minimum
from dynident.motion.splines.series import CHUNK_SAMPLES, ScaledSeries
from dynident.motion.splines.spline import prepare_data
from dynident.runtime import ConfigError, InputError, Noun, setting_text, settings_text
from dynident.runtime.arrays import Array

Order = Literal[2, 3]
OptionalValues = Sequence[float | None]
# bandwidths in samples between which that of the largest likelihood is sought
MIN_WIENER_BANDWIDTH, MAX_WIENER_BANDWIDTH = 0.3, 20_000.0
GRID_BANDWIDTHS = 20  # bandwidths that are tried first
# of log p: how far the likeliest of all data may be, how close to come; in steps
START_STEP, LOG_P_TOLERANCE, MAX_MINIMISER_STEPS = 0.5, 1e-3, 40


class WienerFit(Noun):
    """Smoothed columns (N, k) with two derivatives, and their noise.

    By column (k): ``sigma``, the standard deviation of the noise; ``residual_sigma``, the likeliest one for the
    same smoothing; ``intensity`` (unit^2 s^(1 - 2 m)) and ``bandwidth`` (s).

    ``bandwidth`` is (lam h)^(1 / 2 m), h the mean step: the gain at f (Hz) is 1 / (1 + (2 pi f bandwidth)^(2 m)).
    It is infinite, and the intensity zero, where the data are a polynomial below degree m.
    """

    values: Array
    first_derivative: Array
    second_derivative: Array
    sigma: Array
    residual_sigma: Array
    intensity: Array
    bandwidth: Array


def wiener(
    t: Array,
    y: Array,
    order: Order,
    sigma: OptionalValues,
    intensity: OptionalValues,
    names: Sequence[str] | None = None,
) -> WienerFit:
    """Smooth the columns of y (N, k) at the times t (N), s, increasing; N > order.

    ``sigma`` and ``intensity`` (k) are those of each column where they are known; None takes the likeliest value.
    An intensity is only used where sigma is known, too. Raises InputError for data that cannot be smoothed.
    """
    if len(t) <= order:
        raise InputError(f"an integrated Wiener process of order {order} needs {order + 1} samples, got {len(t)}.")
    names = [f"column {k}" for k in range(y.shape[1])] if names is None else names
    fit = _fit_cubic if order == 2 else _fit_quintic
    values, first_derivative, second_derivative, ratio, penalised_rss = fit(t, y, sigma, intensity, names)
    # the rounding of the data bounds the noise from below
    rounding = np.maximum(4 * EPS * np.abs(y).max(axis=0), 1e-100)
    residual_sigma = np.maximum(np.sqrt(penalised_rss / (len(t) - order)), rounding)
    pairs = zip(residual_sigma, sigma, strict=True)
    noise = np.array([estimate if given_sigma is None else given_sigma for estimate, given_sigma in pairs])
    bandwidth = (ratio * float(t[-1] - t[0]) / (len(t) - 1)) ** (0.5 / order)
    return WienerFit(values, first_derivative, second_derivative, noise, residual_sigma, noise**2 / ratio, bandwidth)


@dataclass(frozen=True)
class _LikelihoodRule(Rule):
    """Choose the lam of each column: the likeliest for a known or unknown noise, or that of a known process."""

    sigma: tuple[float | None, ...]
    intensity: tuple[float | None, ...]

    def choose(self, series: ScaledSeries, column: int) -> SplineSearch:
        """Minimise minus the restricted log-likelihood over log p."""
        sigma, intensity = self.sigma[column], self.intensity[column]
        if sigma is None:
            return (yield from search_minimum(series, reml_criterion))
        if intensity is None:
            return (yield from search_minimum(series, likelihood_criterion))
        return (yield from Fixed(lam=1.0 / intensity if intensity > 0 else inf).choose(series, 0))


ColumnFits = tuple[Array, Array, Array, Array, Array]  # values, two derivatives; lam and whole by column


def _fit_cubic(
    t: Array, y: Array, sigma: OptionalValues, intensity: OptionalValues, names: Sequence[str]
) -> ColumnFits:
    unit = np.array([1.0 if deviation is None else deviation for deviation in sigma])
    fit = smooth(t, y, _LikelihoodRule(tuple(sigma), tuple(intensity)), sigma=unit, names=names)
    bend, ratio = fit.derivative(2), np.asarray(fit.lam) * unit**2
    # exact integral of the squared second derivative, which is linear between samples
    a, b, h = bend[:-1], bend[1:], np.diff(t)[:, None]
    energy = (h / 3 * (a * a + a * b + b * b)).sum(axis=0)
    penalty = np.zeros_like(energy)
    np.multiply(ratio, energy, out=penalty, where=np.isfinite(ratio))
    return fit.values, fit.derivative(1), bend, ratio, np.asarray(fit.S) * unit**2 + penalty


def _fit_quintic(
    t: Array, y: Array, sigma: OptionalValues, intensity: OptionalValues, names: Sequence[str]
) -> ColumnFits:
    time, step, data, _, _ = prepare_data(t, y)
    mean = float(step.sum()) / len(step)
    system = QuinticSystem(step / mean)
    x = (time - time[0]) / mean
    columns = []
    for k, name in enumerate(names):
        noise_model = sigma[k], intensity[k]
        try:
            columns.append(_fit_quintic_column(system, x, np.ascontiguousarray(data[:, k]), mean, *noise_model))
        except IllConditionedError as error:
            raise InputError(
                f"{name} cannot be smoothed: {error}. The smoothing of thousands of samples, or the ratio of the time "
                "steps, is too large for double precision: average neighbouring samples first, or leave out stamps "
                "that nearly coincide."
            ) from error
    values, first_derivative, second_derivative, ratio, penalised_rss = (
        np.array(rows) for rows in zip(*columns, strict=True)
    )
    return values.T.copy(), first_derivative.T / mean, second_derivative.T / mean**2, ratio, penalised_rss


def _fit_quintic_column(
    system: QuinticSystem, x: Array, y: Array, mean: float, sigma: float | None, intensity: float | None
) -> tuple[Array, Array, Array, float, float]:
    """Return values, two derivatives (per sample), lam and the penalised rss of a column.

    A parabola, which no smoothing changes, is subtracted first: the remainder is small and loses fewer digits.
    """
    # a power of two as the unit loses no digits
    size = 2.0 ** round(log2(reach)) if (reach := float(np.ptp(y))) > 0 else 1.0
    normalised = (y - y[0]) / size
    centre = np.polynomial.Polynomial.fit(x, normalised, 2)
    parabola = [np.asarray(centre.deriv(k)(x) if k else centre(x)) for k in range(3)]
    residual = normalised - parabola[0]
    # a residual of the size of rounding says nothing about the smoothing
    tolerance = 4 * EPS * float(np.abs(y).max()) / size + EPS * (64 + len(y))
    ratio, whole = inf, float(residual @ residual)
    if not (np.abs(residual).max() <= tolerance or intensity == 0):
        noise = None if sigma is None else sigma / size
        signal = None if intensity is None or sigma is None else intensity * mean**5 / sigma**2
        solution = _solve_likeliest(system, residual, noise, signal)
        ratio, whole = 0.5 / solution.p * mean**5, solution.penalised_rss
        derived = system.derivatives(solution.g, solution.p * solution.u)
        parabola = [term + correction for term, correction in zip(parabola, (solution.g, *derived), strict=True)]
    values, first_derivative, second_derivative = (size * term for term in parabola)
    return values + y[0], first_derivative, second_derivative, ratio, whole * size**2


def _solve_likeliest(system: QuinticSystem, y: Array, sigma: float | None, signal: float | None) -> QuinticSolution:
    """Return the solution for the likeliest p, or for ``signal`` = 1 / lam of a known process in scaled units."""
    if signal is not None:
        return system.solve(0.5 * signal, y)
    # a grid on the middle part of long data, a descent there, and then a short one on all of them
    ends = log(0.5 / min(float(len(y)), MAX_WIENER_BANDWIDTH) ** 6), log(0.5 / MIN_WIENER_BANDWIDTH**6)
    part = slice(0, len(y))
    if len(y) >= 4 * CHUNK_SAMPLES:  # the middle says where to start
        part = slice((len(y) - CHUNK_SAMPLES) // 2, (len(y) + CHUNK_SAMPLES) // 2)
    chunk = _Criterion(QuinticSystem(system.step[part][: part.stop - part.start - 1]), y[part], sigma)
    grid = np.linspace(*ends, GRID_BANDWIDTHS).tolist()
    x, step = min(grid, key=chunk), grid[1] - grid[0]
    if len(y) > CHUNK_SAMPLES:
        x, step = _minimise(chunk, x, step, ends), START_STEP
    criterion = chunk if chunk.system.size == system.size else _Criterion(system, y, sigma)
    return system.solve(exp(_minimise(criterion, x, step, ends)), y)


class _Criterion:
    """-2 log of the restricted likelihood per sample, up to a constant, as a cached function of log p.

    An unknown noise takes its likeliest value.
    """

    def __init__(self, system: QuinticSystem, y: Array, sigma: float | None) -> None:
        self.system, self._y, self._sigma = system, y, sigma
        self.known: dict[float, float] = {}

    def __call__(self, x: float) -> float:
        """Return the value at x = log p, inf where double precision is not enough for it."""
        if x not in self.known:
            self.known[x] = self._value(x)
        return self.known[x]

    def _value(self, x: float) -> float:
        try:
            solution = self.system.solve(exp(x), self._y)
        except IllConditionedError:
            return inf
        size = self.system.size
        rss = solution.penalised_rss
        fit = log(max(rss, TINY)) if self._sigma is None else rss / (self._sigma**2 * size)
        return fit + solution.log_det / size


def _minimise(criterion: _Criterion, x: float, step: float, ends: tuple[float, float]) -> float:
    """Return the minimiser of the criterion in the valley of x, within the ends: downhill, then by parabolas."""
    # walk downhill with growing steps until the lowest value lies between two others
    low, x, high = (min(max(x + k * step, ends[0]), ends[1]) for k in (-1, 0, 1))
    while min(criterion(low), criterion(high)) < criterion(x):
        step *= 2
        if criterion(low) < criterion(high):
            low, x, high = max(low - step, ends[0]), low, x
        else:
            low, x, high = x, high, min(high + step, ends[1])
    # a parabola through the three lowest points; bisection where its vertex leaves the bracket
    for _ in range(MAX_MINIMISER_STEPS):
        new = _parabola_vertex(sorted(criterion.known.items(), key=lambda point: point[1])[:3])
        if not low < new < high:
            new = 0.5 * (x + (low if x - low > high - x else high))
        if abs(new - x) < LOG_P_TOLERANCE:
            return new
        if criterion(new) < criterion(x):
            low, x, high = (low, new, x) if new < x else (x, new, high)
        else:
            low, high = (new, high) if new < x else (low, new)
    return x


def _parabola_vertex(points: list[tuple[float, float]]) -> float:
    """Return the minimiser of the parabola through three points; nan where there is none."""
    (a, fa), (b, fb), (c, fc) = points
    left_term, right_term = (b - a) * (fb - fc), (b - c) * (fb - fa)
    curve = 2.0 * (left_term - right_term)
    return b - ((b - a) * left_term - (b - c) * right_term) / curve if curve and isfinite(curve) else nan


def posterior_errors(t: Array, order: Order, sigma: Array, intensity: Array) -> Array:
    """Return standard errors (order, N, k) of position, velocity and, for order 3, acceleration at the times t (N), s.

    ``sigma`` and ``intensity`` (k) are those of the noise and of the process. The information of the past and that of
    the future, two filters in information form that know nothing at first, add up with that of the sample itself
    (Fraser and Potter, 1969). All numbers are in units of the bandwidth and of sigma.
    """
    step, count = np.diff(t)[:, None], len(sigma)
    with np.errstate(divide="ignore"):
        width = (sigma**2 / intensity * step.mean()) ** (0.5 / order)
    # in units of the bandwidth, all entries of the information are of like size
    unit = np.minimum(np.maximum(width, step.mean()), t[-1] - t[0])
    steps, noise = step / unit, np.tile(intensity * unit ** (2 * order - 1) / sigma**2, 2)
    information = _past_information(np.concatenate([steps, steps[::-1]], axis=1), noise, order)
    mirror = np.outer(sign := (-1.0) ** np.arange(order), sign)  # time runs backward: odd derivatives change their sign
    total = information[:, :count] + mirror * information[::-1, count:]
    # the sample itself adds the information of one measurement of the position
    total[..., 0, 0] += 1.0
    variance = np.diagonal(np.linalg.inv(total), axis1=-2, axis2=-1)
    return np.asarray(np.moveaxis(sigma[:, None] * np.sqrt(variance) / unit[:, None] ** np.arange(order), -1, 0))


def _past_information(step: Array, noise: Array, order: int) -> Array:
    """Return the information (N, k, m, m) that the samples before each one hold on its state, for unit noise."""
    powers = np.arange(order)
    factorial = np.array([1.0, 1.0, 2.0])
    up = powers[None, :] - powers[:, None]
    back = np.where(up >= 0, (-1.0) ** up / factorial[np.abs(up)], 0.0)  # of the state a step earlier, times step^up
    remaining = order - 1 - powers
    total = remaining[:, None] + remaining[None, :] + 1
    # covariance that a step adds, times step^total
    spread = 1.0 / (factorial[remaining][:, None] * factorial[remaining] * total)
    out = np.zeros((len(step) + 1, step.shape[1], order, order))
    for k, h in enumerate(step[:, :, None, None]):
        # add the sample, move the state one step on, and lose what the process noise takes (matrix inversion lemma)
        updated = out[k].copy()
        updated[:, 0, 0] += 1.0
        transition = back * h ** np.maximum(up, 0)
        propagated = np.swapaxes(transition, -1, -2) @ updated @ transition
        added = noise[:, None, None] * spread * h**total
        out[k + 1] = np.linalg.solve(np.eye(order) + propagated @ added, propagated)
    return out


@dataclass(frozen=True)
class KalmanSmoother(Smoother):
    """The most probable motion of joints whose jerk (order 3) or acceleration (order 2) is white noise.

    Each joint's position is an integrated Wiener process of ``order`` m, whose derivative of order m is white noise of
    spectral density ``intensity`` (rad^2 s^(1 - 2 m)), measured with white noise of standard deviation ``sigma`` (rad,
    m); nothing is known of its start. Either is one number or a mapping by joint name; None, and a joint that a mapping
    lacks, takes the value of the largest restricted likelihood. The posterior mean, which a Kalman filter and the
    smoother of Rauch, Tung and Striebel (1965) would give, is found as the smoothing spline that it is: cubic for order
    2, as ``Spline(REML())``, quintic for order 3. With order 3 the acceleration is a state; with order 2 it is the mean
    of white noise.

    The mask leaves out, at both ends, ``ends`` bandwidths of the widest kernel of a joint that moves, plus one step,
    but at most a quarter of the log: a joint that is smoothed over all of it is nearly a polynomial, which has no ends.
    After k bandwidths exp(-k / 2) is left of a wrong jerk at the end with order 3, and with order 2 exp(-k / sqrt 2)
    of a wrong acceleration.

    The likelihood takes the noise as white. That of a filtered encoder is not, and is followed: give sigma then.

    Calling it returns a ``Motion``. Raises ConfigError for bad settings or unknown joints, and InputError where the log
    is too short or cannot be smoothed.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> q = np.sin(t) + 1e-3 * np.random.default_rng(0).standard_normal(1001)
    >>> log = dy.Log(t, q[:, None], tau=np.cos(t)[:, None], joints=("hinge",))
    >>> motion = dy.KalmanSmoother()(log)
    >>> print(f"noise found {motion.smoothing['sigma'][0]:.2g} rad")
    noise found 0.00097 rad
    >>> print(f"error of the acceleration {np.abs(motion.ddq[:, 0] + np.sin(t))[motion.mask].max():.3f} rad/s^2")
    error of the acceleration 0.075 rad/s^2
    """

    order: Order = 3
    sigma: Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]] | None, BY_JOINT] = None
    intensity: Annotated[Annotated[float, Ge(0)] | Mapping[str, Annotated[float, Ge(0)]] | None, BY_JOINT] = None
    ends: Annotated[float, Ge(0)] = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.intensity is not None and self.sigma is None:
            raise ConfigError("intensity is given without sigma: give both, or sigma alone, or none.")

    @property
    def method(self) -> str:
        """The method in words."""
        name = "acceleration" if self.order == 2 else "jerk"
        noise = "noise as given, intensity of " * (self.sigma is not None) + "maximum likelihood"
        noise = noise if self.intensity is None else "noise and intensity as given"
        return f"Kalman smoother of order {self.order} (white {name}), {noise}"

    def __call__(self, log: Log) -> Motion:
        """Smooth; ``smoothing`` holds per joint sigma, the noise left, intensity, bandwidth (s), cut-off (Hz)."""
        fit = self._fit(log)
        rests = at_rest(log.q, fit.values, fit.residual_sigma)
        widths = fit.bandwidth[np.isfinite(fit.bandwidth) & ~rests]
        length = float(log.t[-1] - log.t[0])
        step = length / (len(log) - 1)
        # a joint that is smoothed over all of the log is nearly a polynomial, which has no ends to mask
        reach = max(step, min(self.ends * float(widths.max(initial=0.0)) + step, length / 4))
        mask = ends_mask(log, reach, reach)
        channels = fit.values, fit.first_derivative, fit.second_derivative
        return make_motion(log, channels, mask, self._smoothing_info(fit), rests)

    def standard_errors(self, motion: Motion) -> Array:
        """Return those (order, N, n) of q, dq and, with order 3, ddq of a motion that this smoother has made.

        They hold where the joints move like the process. White noise, which the acceleration of order 2 is, has none.
        """
        sigma, intensity = (np.array(motion.smoothing[name]) for name in ("sigma", "intensity"))
        return posterior_errors(motion.t, self.order, sigma, intensity)

    def as_used(self, motion: Motion) -> KalmanSmoother:
        """Return the smoother with the noise and the intensity, for each joint, that it has used for a motion."""
        sigma, intensity = (
            dict(zip(motion.joints, map(float, motion.smoothing[name]), strict=True)) for name in ("sigma", "intensity")
        )
        return KalmanSmoother(self.order, sigma, intensity, self.ends)

    def _smoothing_info(self, fit: WienerFit) -> dict[str, object]:
        """Return the description of the smoothing that the motion keeps; that of order 2 has the keys of a spline."""
        power = 0.5 / self.order
        with np.errstate(divide="ignore"):
            cutoff = (np.sqrt(2.0) - 1.0) ** power / (2.0 * np.pi * fit.bandwidth)
            quantities = {"sigma": fit.sigma, "noise": fit.residual_sigma, "intensity": fit.intensity}
            quantities |= {"lam": 1.0 / fit.intensity} if self.order == 2 else {}
        quantities |= {"bandwidth": fit.bandwidth, "cutoff": cutoff}
        info: dict[str, object] = {name: tuple(map(float, value)) for name, value in quantities.items()}
        return info | {"order": self.order, "method": self.method}

    def _fit(self, log: Log) -> WienerFit:
        names = [f"joint {name!r}" for name in log.joints]
        sigma, intensity = self.by_joint("sigma", log), self.by_joint("intensity", log)
        for name, noise, process_intensity in zip(log.joints, sigma, intensity, strict=True):
            if noise is None and process_intensity is not None:
                raise ConfigError(f"intensity of joint {name!r} is given without its sigma: give both.")
        try:
            return wiener(log.t, log.q, self.order, sigma, intensity, names)
        except InputError as error:
            raise InputError(f"{log.source}: {error}") from error

    def __str__(self) -> str:
        how = ["by maximum likelihood"]
        if self.sigma is not None:
            how = [f"noise {setting_text(self.sigma)} rad or m"]
            is_given = self.intensity is not None
            how += [f"intensity {setting_text(self.intensity)}" if is_given else "the rest by maximum likelihood"]
        name = ", ".join([f"Kalman smoother of order {self.order}", *how])
        return settings_text(name, self, ("order", "sigma", "intensity"))
