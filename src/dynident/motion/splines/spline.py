"""The natural cubic smoothing spline after Reinsch (1967): article, eqs. (12)-(36)."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynident.motion.splines.banded import Grid, IllConditionedError, Solution, System
from dynident.motion.splines.compiled import BareProblem, column_ranges, fit_single, slopes, spline_values
from dynident.motion.splines.rules import Constraint, Rule, check_columns, kernel_setting
from dynident.motion.splines.search import SplineSearch, once, run_searches
from dynident.motion.splines.series import ScaledSeries, noise_sigma
from dynident.runtime import ConfigError, InputError, Noun
from dynident.runtime.arrays import Array, as_numbers

MAX_VALUE = 1e100  # squares and fourth powers of allowed values must not overflow


class SmoothingSpline(Noun):
    """A natural cubic spline g fitted to one or k series on a common time grid.

    ``t`` (N); ``values`` = a = g(t) and ``c`` = g''(t) / 2, both (N,) or (N, k) like the data; per series (a float, or
    an array (k,)): ``p`` (eq. 15) and ``lam`` = 1 / (2 p), ``S`` the sum (14) reached, ``sigma`` and ``weights``
    ((N, 1), (N, k) or None) with delta = sigma / sqrt(weight), ``residual`` of the linear system (32) relative to its
    right-hand side, and ``accuracy``, a bound of the relative error of c as computed.
    """

    t: Array
    values: Array
    c: Array
    p: Array | float
    lam: Array | float
    S: Array | float
    sigma: Array | float
    residual: Array | float
    accuracy: Array | float
    weights: Array | None = None

    def __repr__(self) -> str:
        cutoffs = np.atleast_1d(self.cutoff)
        cutoff_text = ", ".join(f"{value:.3g}" for value in cutoffs[:6]) + ", ..." * (len(cutoffs) > 6)
        span = f"{len(self.t)} samples, {self.t[0]:.6g} to {self.t[-1]:.6g}"
        return f"<SmoothingSpline of {len(cutoffs)} series: {span}; cut-off {cutoff_text} Hz>"

    @cached_property
    def edf(self) -> Array:
        """Effective degrees of freedom per series: 2 for a straight line, N for interpolation."""
        n, p = len(self.t), np.atleast_1d(self.p)
        # a line and an interpolating spline have limits of p at which the trace is known
        limits = {0.0: 2.0, np.inf: float(n)}
        out = np.array([limits.get(float(value), np.nan) for value in p])
        systems, step, variance = _systems(self.t, np.diff(self.t), self.weights, len(p))
        scaled_p = p * step**3 / (np.array(variance) * np.atleast_1d(self.sigma) ** 2)
        pending = [k for k in range(len(p)) if np.isnan(out[k])]
        none = np.zeros(n - 2)
        solutions = run_searches(
            [once(BareProblem(systems[k], none), float(scaled_p[k]), refine=False, trace=True) for k in pending]
        )
        out[pending] = [2.0 + solution.rise for solution in solutions]
        return self._match_shape(out)

    @property
    def noise(self) -> Array:
        """Noise standard deviation from the residuals, sqrt(sum(w (y - g)^2) / (N - edf)); nan for interpolation."""
        residual_degrees = np.atleast_1d(len(self.t) - self.edf)
        ratio = np.full(len(residual_degrees), np.nan)
        np.divide(np.atleast_1d(self.S), residual_degrees, out=ratio, where=residual_degrees > 0)
        return self._match_shape(np.sqrt(ratio) * np.atleast_1d(self.sigma))

    @property
    def bandwidth(self) -> Array:
        """Width of the smoothing kernel in seconds, (lam sigma^2 h)^(1/4) with h the mean step (0 to inf)."""
        h = (self.t[-1] - self.t[0]) / (len(self.t) - 1)
        return self._match_shape((np.atleast_1d(self.lam) * np.atleast_1d(self.sigma) ** 2 * h) ** 0.25)

    @property
    def cutoff(self) -> Array:
        """Cut-off frequency (Hz), at which the gain 1 / (1 + (2 pi f bandwidth)^4) is 1 / sqrt(2)."""
        with np.errstate(divide="ignore"):
            return self._match_shape((np.sqrt(2.0) - 1.0) ** 0.25 / (2.0 * np.pi * np.atleast_1d(self.bandwidth)))

    def _match_shape(self, value: Array) -> Array:
        return value if self.values.ndim == 2 else np.asarray(value[0])[()]

    def derivative(self, order: int = 1) -> Array:
        """Return the derivative of order 0 to 3 at the samples, shaped like the data (eqs. 34-36).

        The third derivative is constant between samples; its value at a sample is that of the piece that begins there
        (at the last sample, that ends there). Raises ConfigError for another order.
        """
        if order not in (0, 1, 2, 3):
            raise ConfigError(f"order of the derivative is {order!r}; a cubic spline has 0, 1, 2 and 3.")
        if order == 0:
            return self.values
        if order == 2:
            return 2.0 * self.c
        if order == 1 and (slope := slopes(self.t, self.values, self.c)) is not None:
            return slope
        h = np.diff(self.t)
        h = h if self.values.ndim == 1 else h[:, None]
        out = np.empty_like(self.values)
        if order == 3:
            np.divide(np.diff(self.c, axis=0), 0.5 * h, out=out[:-1])
            out[-1] = out[-2]
            return out
        np.divide(np.diff(self.values, axis=0), h, out=out[:-1])
        out[:-1] -= h * (2.0 * self.c[:-1] + self.c[1:]) / 3.0
        out[-1] = out[-2] + h[-1] * (self.c[-2] + self.c[-1])
        return out

    def __call__(self, t: ArrayLike, order: int = 0, *, extrapolate: bool = False) -> Array:
        """Return g or a derivative (order 0 to 3) at any times, shape (..., ) or (..., k); eqs. (34)-(36).

        Raises InputError outside the data unless ``extrapolate`` is set: the natural spline continues as a straight
        line. Raises ConfigError for another order.
        """
        x = as_numbers(t)
        if not np.isfinite(x).all():
            raise InputError("times to evaluate the spline at must be finite.")
        outside = (x < self.t[0]) | (x > self.t[-1])
        if outside.any() and not extrapolate:
            raise InputError(
                f"t = {x[outside].flat[0]} lies outside the data ({self.t[0]} to {self.t[-1]}); "
                "pass extrapolate=True to continue as a straight line."
            )
        # the cubic of the interval that holds x; beyond the data, its tangent at the end
        i = np.clip(np.searchsorted(self.t, x, side="right") - 1, 0, len(self.t) - 2)
        h, s = self.t[i + 1] - self.t[i], np.clip(x, self.t[0], self.t[-1]) - self.t[i]
        beyond = x - np.clip(x, self.t[0], self.t[-1])
        if self.values.ndim == 2:
            h, s, beyond, outside = h[..., None], s[..., None], beyond[..., None], outside[..., None]
        a, c = self.values[i], self.c[i]
        d = (self.c[i + 1] - c) / (3 * h)
        b = (self.values[i + 1] - a) / h - h * (c + h * d)
        # the second derivative is zero at the ends, so that a straight line continues the spline smoothly
        slope = b + s * (2 * c + 3 * s * d)
        if order == 0:
            return a + s * (b + s * (c + s * d)) + beyond * slope  # type: ignore[no-any-return]
        if order == 1:
            return slope  # type: ignore[no-any-return]
        if order not in (2, 3):
            raise ConfigError(f"order of the derivative is {order!r}; a cubic spline has 0, 1, 2 and 3.")
        return np.where(outside, 0.0, 2 * c + 6 * s * d if order == 2 else 6 * d)


def smooth(
    t: ArrayLike,
    y: ArrayLike,
    rule: Rule | None = None,
    *,
    sigma: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> SmoothingSpline:
    """Smooth one or several series by the natural cubic spline of eqs. (12)-(36).

    ``t`` (N) strictly increasing, uniform or not, N >= 3; ``y`` (N,) or (N, k), each column with its own p. ``rule``
    chooses p: ``Constraint(S)`` (the default, S = N), ``Fixed(p=...)`` or ``Fixed(lam=...)``, ``GCV()``, ``REML()``,
    ``Interpolation()``. delta of eq. (14) is ``sigma / sqrt(weights)``: ``sigma`` one number or one per column; where
    missing, ``noise_sigma`` estimates it for ``Constraint`` and it is one for the others; ``weights`` positive,
    (N,) or (N, k). ``names`` are the names of the columns in errors. Double precision limits the bandwidth m, in
    samples: eps * m^4 << 1, m below 2000.

    Raises InputError for data that cannot be smoothed (not finite, times not increasing, too few samples), ConfigError
    for a bad setting, and InputError where the bandwidth is too large for double precision.

    >>> import numpy as np
    >>> t = np.linspace(0.0, 10.0, 1001)
    >>> y = np.sin(t) + 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    >>> g = smooth(t, y, sigma=1e-3)
    >>> print(f"{g.edf:.0f} degrees of freedom, cut-off {g.cutoff:.1f} Hz")
    37 degrees of freedom, cut-off 1.3 Hz
    >>> print(f"at 5 s: {g(5.0):.2f}, its second derivative {g(5.0, order=2):.2f}")
    at 5 s: -0.96, its second derivative 0.96
    """
    rule = Constraint() if rule is None else rule
    if not isinstance(rule, Rule):
        raise ConfigError(f"rule is {rule!r}; give a rule, such as Constraint(), GCV() or Fixed(lam=...).")
    if weights is None and (fit := _fit_single(t, y, rule, sigma)) is not None:
        return fit
    time, step, data, low, high = prepare_data(t, y)
    columns = np.ascontiguousarray(data.reshape(len(time), -1))
    k = columns.shape[1]
    check_columns(rule, k)
    weight = _check_weights(weights, columns)
    scale = _column_sigmas(time, columns, weight, sigma, needed=rule.needs_sigma)
    systems, h, variance = _systems(time, step, weight, k)
    noise = [a * b**0.5 for a, b in zip(scale.tolist(), variance, strict=True)]
    series = ScaledSeries.of(systems, time, columns, noise, h, low, high)
    column_names = [f"column {j}" for j in range(k)] if names is None else names
    solved = run_searches([_name_errors(rule.choose(column, j), column_names[j]) for j, column in enumerate(series)])
    return _collect(time, data, series, solved, scale, weight)


def _fit_single(t: ArrayLike, y: ArrayLike, rule: Rule, sigma: Any) -> SmoothingSpline | None:
    """Fit a single series in one call of the kernel; None where that cannot be done, and why is not said."""
    time, data = as_numbers(t), as_numbers(y)
    if time.ndim != 1 or data.shape not in {(len(time),), (len(time), 1)}:
        return None
    if sigma is None:
        sigma = 0.0 if rule.needs_sigma else 1.0
    elif not isinstance(sigma, float | int) or not sigma > 0:
        return None
    setting = kernel_setting(rule, len(time))
    fit = None if setting is None else fit_single(time, data, *setting, sigma)
    if fit is None:
        return None
    values, c, figures = fit
    if data.ndim == 1:
        return SmoothingSpline(time.copy(), values, c, *figures)
    return SmoothingSpline(time.copy(), values[:, None], c[:, None], *figures[:, None])


def prepare_data(t: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array, list[float], list[float]]:
    """Return times, their steps and data as arrays, and the smallest and largest value of each column; InputError."""
    time, data = as_numbers(t).copy(), as_numbers(y)
    if time.ndim != 1 or data.ndim not in (1, 2) or len(data) != len(time) or data.size == 0:
        raise InputError(f"t and y have shapes {time.shape} and {data.shape}; expected (N,) with (N,) or (N, k).")
    if len(time) < 3:
        raise InputError(f"a smoothing spline needs at least 3 samples, got {len(time)}.")
    _check_values("t", time)
    low, high = _check_values("y", data)
    step = time[1:] - time[:-1]
    if not step.min() > 0:
        i = int(np.argmax(step <= 0))
        raise InputError(f"t[{i + 1}] = {time[i + 1]} does not exceed t[{i}] = {time[i]}; sort, drop repeats.")
    return time, step, data, low, high


def _check_values(name: str, value: Array) -> tuple[list[float], list[float]]:
    low, high, finite = column_ranges(np.ascontiguousarray(value.reshape(len(value), -1)))
    if not finite:
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(value))[0])
        raise InputError(f"{name}{list(where)} is {value[where]}; remove samples that are not finite.")
    for a, b in zip(low, high, strict=True):
        if b - a > MAX_VALUE or 0 < b - a < 1 / MAX_VALUE or max(-a, b) > MAX_VALUE:
            raise InputError(f"{name} spans {b - a:g}: that is out of range (1e-100 to 1e100); choose another unit.")
    return low, high


def _check_weights(weights: ArrayLike | None, columns: Array) -> Array | None:
    if weights is None:
        return None
    weight = as_numbers(weights)
    weight = weight[:, None] if weight.ndim == 1 else weight
    if weight.ndim != 2 or weight.shape not in {(len(columns), 1), columns.shape}:
        raise ConfigError(f"weights have shape {weight.shape}; expected ({len(columns)},) or {columns.shape}.")
    if not (np.isfinite(weight).all() and (weight > 0).all()):
        raise ConfigError("weights must be positive and finite; leave out samples that should not count.")
    return weight


def _column_sigmas(t: Array, columns: Array, weight: Array | None, sigma: ArrayLike | None, *, needed: bool) -> Array:
    k = columns.shape[1]
    if sigma is not None:
        value = as_numbers(sigma)
        if value.shape not in ((), (k,)):
            raise ConfigError(f"sigma has shape {value.shape}; give one number, or one for each of {k} columns.")
        value = np.full(k, value)
        if not all(1 / MAX_VALUE <= number < MAX_VALUE for number in value.tolist()):
            raise ConfigError(f"sigma is {sigma}; it must be positive; without smoothing, interpolate.")
        return value
    if not needed:
        return np.ones(k)
    if len(t) < 6:
        raise InputError(f"{len(t)} samples are too few to estimate sigma from; give sigma.")
    return noise_sigma(t, columns, weight)


def _systems(t: Array, step: Array, weights: Array | None, k: int) -> tuple[list[System], float, list[float]]:
    """Return the scaled system of each of k columns, the mean step, and the means (k) of 1 / weight.

    ``step`` is scaled in place.
    """
    h = float(t[-1] - t[0]) / len(step)
    step /= h
    grid = Grid(step)
    if weights is None:
        return [System(grid)] * k, h, [1.0] * k
    variances = [1.0 / column for column in np.ascontiguousarray(weights.T)]
    means = [float(variance.mean()) for variance in variances]
    systems = [System(grid, variance / mean) for variance, mean in zip(variances, means, strict=True)]
    shared = k if len(systems) == 1 else 1
    return systems * shared, h, means * shared


def _name_errors(search: SplineSearch, name: str) -> SplineSearch:
    """Run a search so that its errors name the column; ConfigError where a rule returned something else."""
    if not isinstance(search, Generator):
        raise ConfigError(
            f"{name}: the method choose of the rule returned {type(search).__name__}, expected a generator of trials; "
            "end it with: return (yield from dynident.motion.splines.search.once(series, p))"
        )
    try:
        return (yield from search)
    except IllConditionedError as error:
        raise InputError(
            f"{name} cannot be smoothed with these settings: {error}. The bandwidth of thousands of samples, or the "
            "ratio of the time steps, is too large for double precision: average neighbouring samples first, smooth "
            "less, or leave out stamps that nearly coincide."
        ) from error


def _collect(
    time: Array, data: Array, series: list[ScaledSeries], solved: list[Solution], sigma: Array, weight: Array | None
) -> SmoothingSpline:
    columns = np.ascontiguousarray(data.reshape(len(time), len(solved)))
    # back to the user's units: values are the data less D^2 Q u, the second derivative is p u
    unit = 1.0 / (series[0].step * series[0].step)
    interpolated = [column.p == np.inf for column in solved]
    size = [0.0 if exact else column_series.size for column_series, exact in zip(series, interpolated, strict=True)]
    bend = [
        column_series.size * unit * (1.0 if exact else column.p)
        for column_series, column, exact in zip(series, solved, interpolated, strict=True)
    ]
    u = [column.u for column in solved if column.u is not None]
    values, c = spline_values(columns, [column.system for column in series], u, size, bend)
    # with p = 0 the straight line itself is more exact than what the system gives
    for k, column in enumerate(solved):
        if column.p == 0:
            values[:, k] = columns[:, k] - size[k] * (series[k].y - series[k].line())
    p = [column.p * column_series.p_scale for column_series, column in zip(series, solved, strict=True)]
    lam = [0.5 / value if value else np.inf for value in p]
    S = [
        column.rss / (column_series.noise * column_series.noise)
        for column_series, column in zip(series, solved, strict=True)
    ]
    accuracy = [column_series.accuracy(column) for column_series, column in zip(series, solved, strict=True)]
    figures: list[Any] = [np.array(x) for x in (p, lam, S, sigma, [column.residual for column in solved], accuracy)]
    if data.ndim == 1:
        values, c, figures = values[:, 0], c[:, 0], [x[0] for x in figures]
    return SmoothingSpline(time, values, c, *(*figures, weight))
