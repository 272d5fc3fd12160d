"""Positions as integrated Wiener processes with white measurement noise: the likeliest noise, and the smoothed motion.

The derivative of order m of the position is white noise of spectral density ``intensity``, and nothing is known of the
start (diffuse). Given the samples, the mean of the position is the spline that minimises sum((g - y)^2) + lam
integral((g^(m))^2), lam = noise variance / intensity (Wahba, 1978): cubic for m = 2, quintic for m = 3. A Kalman filter
and the backward pass of Rauch, Tung and Striebel (1965) would give the same; the banded systems of the splines are
faster. The likelihood of what does not depend on the start is the restricted one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, isfinite, log, log2, nan
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.splines.banded import EPS, TINY, IllConditionedError
from dynident.splines.quintic import Quintic, QuinticSolution
from dynident.splines.rules import Fixed, Rule
from dynident.splines.search import Search, by_likelihood, by_reml, minimal
from dynident.splines.series import CHUNK, Series
from dynident.splines.spline import checked, smooth

__all__ = ["Known", "Order", "WienerFit", "posterior_errors", "wiener"]

Array = NDArray[np.float64]
Order = Literal[2, 3]
Known = Sequence[float | None]
NARROWEST, WIDEST = 0.3, 20_000.0  # bandwidths in samples between which that of the largest likelihood is sought
GRID = 20  # bandwidths that are tried first
NEARBY, CLOSE, STEPS = 0.5, 1e-3, 40  # of log p: how far the likeliest of all data may be, how close to come; in steps


@dataclass(frozen=True, eq=False)
class WienerFit:
    """Smoothed columns (N, k) with two derivatives, and by column (k) ``sigma``, the standard deviation of the noise,
    ``left``, the likeliest one for the same smoothing, ``intensity`` (unit^2 s^(1 - 2 m)) and ``bandwidth`` (s).

    ``bandwidth`` is (lam h)^(1 / 2 m), h the mean step: the gain at f (Hz) is 1 / (1 + (2 pi f bandwidth)^(2 m)). It is
    infinite, and the intensity zero, where the data are a polynomial below degree m.
    """

    values: Array
    first: Array
    second: Array
    sigma: Array
    left: Array
    intensity: Array
    bandwidth: Array

    __repr__ = brief


def wiener(
    t: Array, y: Array, order: Order, sigma: Known, intensity: Known, names: Sequence[str] | None = None
) -> WienerFit:
    """Smooth the columns of y (N, k) at the times t (N), s, increasing; N > order.

    ``sigma`` and ``intensity`` (k) are those of each column where they are known, else None: then the likeliest.
    An intensity is only used where sigma is known, too. Raises InputError for data that cannot be smoothed.
    """
    if len(t) <= order:
        raise InputError(f"an integrated Wiener process of order {order} needs {order + 1} samples, got {len(t)}.")
    names = [f"column {k}" for k in range(y.shape[1])] if names is None else names
    values, first, second, ratio, whole = (_cubic if order == 2 else _quintic)(t, y, sigma, intensity, names)
    left = np.maximum(np.sqrt(whole / (len(t) - order)), np.maximum(4 * EPS * np.abs(y).max(axis=0), 1e-100))
    noise = np.array([own if given is None else given for own, given in zip(left, sigma, strict=True)])
    step = float(t[-1] - t[0]) / (len(t) - 1)
    return WienerFit(values, first, second, noise, left, noise**2 / ratio, (ratio * step) ** (0.5 / order))


@dataclass(frozen=True)
class _MostLikely(Rule):
    """The likeliest lam of each column, for a known noise or for the likeliest one; or the lam of the known process."""

    sigma: tuple[float | None, ...]
    intensity: tuple[float | None, ...]

    def choose(self, series: Series, column: int) -> Search:
        """Minimise minus the restricted log-likelihood over log p."""
        sigma, intensity = self.sigma[column], self.intensity[column]
        if sigma is None:
            return (yield from minimal(series, by_reml))
        if intensity is None:
            return (yield from minimal(series, by_likelihood))
        return (yield from Fixed(lam=_inverse(intensity)).choose(series, 0))


def _inverse(x: float) -> float:
    return 1.0 / x if x > 0 else inf


Found = tuple[Array, Array, Array, Array, Array]  # values, two derivatives; lam and whole by column


def _cubic(t: Array, y: Array, sigma: Known, intensity: Known, names: Sequence[str]) -> Found:
    unit = np.array([1.0 if one is None else one for one in sigma])
    fit = smooth(t, y, _MostLikely(tuple(sigma), tuple(intensity)), sigma=unit, names=names)
    bend, ratio = fit.derivative(2), np.asarray(fit.lam) * unit**2
    a, b, h = bend[:-1], bend[1:], np.diff(t)[:, None]
    energy = (h / 3 * (a * a + a * b + b * b)).sum(axis=0)
    bent = np.zeros_like(energy)
    np.multiply(ratio, energy, out=bent, where=np.isfinite(ratio))
    return fit.values, fit.derivative(1), bend, ratio, np.asarray(fit.S) * unit**2 + bent


def _quintic(t: Array, y: Array, sigma: Known, intensity: Known, names: Sequence[str]) -> Found:
    time, step, data, _, _ = checked(t, y)
    mean = float(step.sum()) / len(step)
    system = Quintic(step / mean)
    x = (time - time[0]) / mean
    columns = []
    for k, name in enumerate(names):
        known = sigma[k], intensity[k]
        try:
            columns.append(_column(system, x, np.ascontiguousarray(data[:, k]), mean, *known))
        except IllConditionedError as error:
            raise InputError(
                f"{name} cannot be smoothed: {error}. The smoothing of thousands of samples, or the ratio of the time "
                "steps, is too large for double precision: average neighbouring samples first, or leave out stamps "
                "that nearly coincide."
            ) from error
    values, first, second, ratio, whole = (np.array(one) for one in zip(*columns, strict=True))
    return values.T.copy(), first.T / mean, second.T / mean**2, ratio, whole


def _column(
    system: Quintic, x: Array, y: Array, mean: float, sigma: float | None, intensity: float | None
) -> tuple[Array, Array, Array, float, float]:
    """Return values, two derivatives (per sample), lam and ``whole`` of a column.

    A parabola, which nothing smooths away, is taken out first: what is left is small, and loses fewer digits.
    """
    size = 2.0 ** round(log2(reach)) if (reach := float(np.ptp(y))) > 0 else 1.0
    scaled = (y - y[0]) / size
    centre = np.polynomial.Polynomial.fit(x, scaled, 2)
    parabola = [np.asarray(centre.deriv(k)(x) if k else centre(x)) for k in range(3)]
    rest = scaled - parabola[0]
    least = 4 * EPS * float(np.abs(y).max()) / size + EPS * (64 + len(y))
    ratio, whole = inf, float(rest @ rest)
    if not (np.abs(rest).max() <= least or intensity == 0):
        noise = None if sigma is None else sigma / size
        signal = None if intensity is None or sigma is None else intensity * mean**5 / sigma**2
        found = _solved(system, rest, noise, signal)
        ratio, whole = 0.5 / found.p * mean**5, found.whole
        derived = system.derivatives(found.g, found.p * found.u)
        parabola = [one + other for one, other in zip(parabola, (found.g, *derived), strict=True)]
    values, first, second = (size * one for one in parabola)
    return values + y[0], first, second, ratio, whole * size**2


def _solved(system: Quintic, y: Array, sigma: float | None, signal: float | None) -> QuinticSolution:
    """Return the solution for the likeliest p, or for ``signal`` = 1 / lam of a known process in scaled units."""
    if signal is not None:
        return system.solve(0.5 * signal, y)
    ends = log(0.5 / min(float(len(y)), WIDEST) ** 6), log(0.5 / NARROWEST**6)
    part = slice(0, len(y))
    if len(y) >= 4 * CHUNK:  # the middle says where to start
        part = slice((len(y) - CHUNK) // 2, (len(y) + CHUNK) // 2)
    chunk = _Criterion(Quintic(system.step[part][: part.stop - part.start - 1]), y[part], sigma)
    grid = np.linspace(*ends, GRID).tolist()
    x, step = min(grid, key=chunk), grid[1] - grid[0]
    if len(y) > CHUNK:
        x, step = _least(chunk, x, step, ends), NEARBY
    whole = chunk if chunk.system.size == system.size else _Criterion(system, y, sigma)
    return system.solve(exp(_least(whole, x, step, ends)), y)


class _Criterion:
    """-2 log of the restricted likelihood per sample, less a constant, as a function of log p, computed once for each.

    Of an unknown noise the likeliest is taken.
    """

    def __init__(self, system: Quintic, y: Array, sigma: float | None) -> None:
        self.system, self._y, self._sigma = system, y, sigma
        self.known: dict[float, float] = {}

    def __call__(self, x: float) -> float:
        """Return the value at x = log p, inf where double precision is not enough for it."""
        if x not in self.known:
            self.known[x] = self._value(x)
        return self.known[x]

    def _value(self, x: float) -> float:
        try:
            found = self.system.solve(exp(x), self._y)
        except IllConditionedError:
            return inf
        size = self.system.size
        fit = log(max(found.whole, TINY)) if self._sigma is None else found.whole / (self._sigma**2 * size)
        return fit + found.log_det / size


def _least(criterion: _Criterion, x: float, step: float, ends: tuple[float, float]) -> float:
    """Return where the criterion is least in the valley of x, within the ends: downhill, then by parabolas."""
    low, x, high = (min(max(x + k * step, ends[0]), ends[1]) for k in (-1, 0, 1))
    while min(criterion(low), criterion(high)) < criterion(x):
        step *= 2
        if criterion(low) < criterion(high):
            low, x, high = max(low - step, ends[0]), low, x
        else:
            low, x, high = x, high, min(high + step, ends[1])
    for _ in range(STEPS):
        new = _vertex(sorted(criterion.known.items(), key=lambda one: one[1])[:3])
        if not low < new < high:
            new = 0.5 * (x + (low if x - low > high - x else high))
        if abs(new - x) < CLOSE:
            return new
        if criterion(new) < criterion(x):
            low, x, high = (low, new, x) if new < x else (x, new, high)
        else:
            low, high = (new, high) if new < x else (low, new)
    return x


def _vertex(points: list[tuple[float, float]]) -> float:
    """Return where the parabola through three points is least; nan where there is none."""
    (a, fa), (b, fb), (c, fc) = points
    first, second = (b - a) * (fb - fc), (b - c) * (fb - fa)
    curve = 2.0 * (first - second)
    return b - ((b - a) * first - (b - c) * second) / curve if curve and isfinite(curve) else nan


def posterior_errors(t: Array, order: Order, sigma: Array, intensity: Array) -> Array:
    """Return standard errors (order, N, k) of position, velocity and, for order 3, acceleration at the times t (N), s.

    ``sigma`` and ``intensity`` (k) are those of the noise and of the process. The information of the past and that of
    the future, two filters in information form that know nothing at first, add up with that of the sample itself
    (Fraser and Potter, 1969). All numbers are in units of the bandwidth and of sigma.
    """
    step, count = np.diff(t)[:, None], len(sigma)
    with np.errstate(divide="ignore"):
        width = (sigma**2 / intensity * step.mean()) ** (0.5 / order)
    unit = np.minimum(np.maximum(width, step.mean()), t[-1] - t[0])
    steps, noise = step / unit, np.tile(intensity * unit ** (2 * order - 1) / sigma**2, 2)
    both = _information(np.concatenate([steps, steps[::-1]], axis=1), noise, order)
    mirror = np.outer(sign := (-1.0) ** np.arange(order), sign)  # time runs backward: odd derivatives change their sign
    whole = both[:, :count] + mirror * both[::-1, count:]
    whole[..., 0, 0] += 1.0
    variance = np.diagonal(np.linalg.inv(whole), axis1=-2, axis2=-1)
    return np.asarray(np.moveaxis(sigma[:, None] * np.sqrt(variance) / unit[:, None] ** np.arange(order), -1, 0))


def _information(step: Array, noise: Array, order: int) -> Array:
    """Return the information (N, k, m, m) on the state at each sample that is in those before it, for noise 1."""
    powers = np.arange(order)
    factorial = np.array([1.0, 1.0, 2.0])
    up = powers[None, :] - powers[:, None]
    back = np.where(up >= 0, (-1.0) ** up / factorial[np.abs(up)], 0.0)  # of the state a step earlier, times step^up
    left = order - 1 - powers
    total = left[:, None] + left[None, :] + 1
    spread = 1.0 / (factorial[left][:, None] * factorial[left] * total)  # covariance a step adds, times step^total
    out = np.zeros((len(step) + 1, step.shape[1], order, order))
    for k, h in enumerate(step[:, :, None, None]):
        known = out[k].copy()
        known[:, 0, 0] += 1.0
        earlier = back * h ** np.maximum(up, 0)
        moved = np.swapaxes(earlier, -1, -2) @ known @ earlier
        added = noise[:, None, None] * spread * h**total
        out[k + 1] = np.linalg.solve(np.eye(order) + moved @ added, moved)
    return out
