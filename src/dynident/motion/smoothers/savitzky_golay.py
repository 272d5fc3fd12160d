"""Savitzky and Golay's smoother: a polynomial through the samples around each sample, by least squares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import legendre
from numpy.typing import NDArray

from dynident.motion.log import Log, Motion
from dynident.motion.smoothers.smoother import BY_JOINT, Smoother, at_rest, make_motion
from dynident.runtime import ConfigError, InputError, setting_text
from dynident.runtime.arrays import Array

Index = NDArray[np.intp]
MAX_WORK_ENTRIES = 2**21  # numbers of the largest work array
MIN_SWEPT_HALF = 64  # samples on either side, from which on sums that go along with the window are faster
MAX_UNEVENNESS = 1e-9  # of a step: stamps that differ by less from equal spacing are equally spaced


def is_even(t: Array) -> bool:
    """Whether times (N), s, are equally spaced but for rounding."""
    step = (t[-1] - t[0]) / (len(t) - 1)
    rounding = 8 * np.finfo(float).eps * max(abs(t[0]), abs(t[-1]))
    ideal = t[0] + step * np.arange(len(t))
    return bool(np.abs(t - ideal).max() <= max(MAX_UNEVENNESS * step, rounding))


def _window_start(t: Array, half: int, rows: Index) -> Index:
    """Return the first sample of the 2 half + 1 around each of ``rows``; at the ends, that of the outermost window."""
    return np.clip(rows - half, 0, len(t) - 2 * half - 1)


def smoothing_kernels(t: Array, half: int, orders: tuple[int, ...], rows: Index) -> list[Array]:
    """Return, for each order, the weights (B, 3, 2 half + 1) of a window's samples in q, dq and ddq at each row."""
    size, top = 2 * half + 1, max(orders)
    starts = _window_start(t, half, rows)
    times = t[starts[:, None] + np.arange(size)]
    middle, reach = (times[:, -1] + times[:, 0]) / 2, (times[:, -1] - times[:, 0]) / 2
    basis = legendre.legvander((times - middle[:, None]) / reach[:, None], top)
    position = (t[rows] - middle) / reach
    values = _basis_derivatives(position, top, reach)
    kernel_list = []
    for order in orders:
        # least squares: kernel = targets' (V V')^-1 V, solved by normal equations of the nearly orthogonal basis
        V, targets = basis[..., : order + 1].transpose(0, 2, 1), values[..., : order + 1].transpose(0, 2, 1)
        weights = np.linalg.solve(np.matmul(V, V.transpose(0, 2, 1)), targets)
        kernel_list.append(np.matmul(weights.transpose(0, 2, 1), V))
    return kernel_list


@cache
def _legendre_derivatives(top: int) -> Array:
    """Return the matrices (3, top + 1, top + 1) of Legendre's polynomials and their first and second derivative."""
    out = np.zeros((3, top + 1, top + 1))
    for times in range(3):
        out[times, : top + 1 - times] = legendre.legder(np.eye(top + 1), times)
    return out


def _basis_derivatives(x: Array, top: int, reach: Array) -> Array:
    """Return values and derivatives (B, 3, top + 1) of the polynomials at x (B).

    ``reach`` (B) is half the time of each window.
    """
    derivatives = np.matmul(legendre.legvander(x, top), _legendre_derivatives(top)).transpose(1, 0, 2)
    return np.asarray(derivatives / reach[:, None, None] ** np.arange(3)[:, None])


def fit_polynomials(t: Array, q: Array, half: int, order: int) -> tuple[Array, Array, Array, float]:
    """Return q, dq, ddq (N, k) of local polynomials, and their degrees of freedom.

    The polynomials of ``order`` go through the 2 half + 1 samples around each sample; at the ends it is that of
    the first or the last window. The degrees of freedom are the trace of the matrix that makes q of the data.
    ``t`` (N) s, ``q`` (N, k).
    """
    count, size = len(t), 2 * half + 1
    out, trace, remaining = np.empty((3, *q.shape)), 0.0, np.r_[0:half, count - half : count]
    # evenly spaced samples share one kernel, so that the fit is a correlation
    if is_even(t):
        kernel = smoothing_kernels(t, half, (order,), np.array([count // 2]))[0][0]
        trace = float(kernel[0, half]) * (count - 2 * half)
        for k, row in enumerate(kernel):
            for j, column in enumerate(q.T):
                out[k, half : count - half, j] = np.correlate(column, row, mode="valid")
    # wide windows: running sums cost the same for any width
    elif half >= MIN_SWEPT_HALF:
        for start in range(half, count - half, half):
            rows = slice(start, min(start + half, count - half))
            out[:, rows], trace_part = _sweep_windows(t, q, half, order, rows)
            trace += trace_part
    else:
        remaining = np.arange(count)
    # what remains, the ends or all samples, each with the kernel of its own window
    block = max(1, MAX_WORK_ENTRIES // (size * (order + 4)))
    for start in range(0, len(remaining), block):
        at = remaining[start : start + block]
        weights, starts = smoothing_kernels(t, half, (order,), at)[0], _window_start(t, half, at)
        out[:, at] = np.matmul(weights, q[starts[:, None] + np.arange(size)]).transpose(1, 0, 2)
        trace += float(weights[np.arange(len(at)), 0, at - starts].sum())
    return out[0], out[1], out[2], trace


def _sweep_windows(t: Array, q: Array, half: int, order: int, rows: slice) -> tuple[Array, float]:
    """Return q, dq, ddq (3, B, k) of ``rows``, at most half a window, and their part of the trace.

    The polynomials of all windows have one basis, so that their normal equations are differences of running sums.
    """
    around = slice(rows.start - half, rows.stop + half)
    time, size, base = t[around], 2 * half + 1, q[rows.start]
    middle, reach = (time[-1] + time[0]) / 2, (time[-1] - time[0]) / 2
    V = legendre.legvander((time - middle) / reach, order)
    gram = _running_sums(V[:, :, None] * V[:, None], size)
    right = _running_sums(V[:, :, None] * (q[around] - base)[:, None], size)
    position = (t[rows] - middle) / reach
    targets = _basis_derivatives(position, order, np.full(len(position), reach)).transpose(0, 2, 1)
    weights = np.linalg.solve(gram, targets)
    motion = np.matmul(weights.transpose(0, 2, 1), right).transpose(1, 0, 2)
    motion[0] += base
    return motion, float((weights[:, :, 0] * targets[:, :, 0]).sum())


def _running_sums(x: Array, size: int) -> Array:
    """Return the sums of ``size`` consecutive rows of x (N, ...), as (N - size + 1, ...)."""
    sums = np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)])
    return np.asarray(sums[size:] - sums[:-size])


def order_differences(t: Array, q: Array, half: int, orders: tuple[int, int], rows: Index) -> tuple[Array, float]:
    """Return how ddq differs between polynomials of two orders at ``rows``, and how noise alone would.

    The first is the mean squares (k) of the difference; the second how many times the variance of the lower order
    they are where there is noise alone. Each row has half a window on either side.
    """
    size, total, gains = 2 * half + 1, np.zeros(q.shape[1]), np.zeros(2)
    one_kernel = is_even(t)
    # blocks of rows whose kernels fit the work array
    block = max(1, MAX_WORK_ENTRIES // (size if one_kernel else size * (orders[1] + 4)))
    for start in range(0, len(rows), block):
        part = rows[start : start + block]
        low, high = (kernel[:, 2] for kernel in smoothing_kernels(t, half, orders, part[:1] if one_kernel else part))
        at, change = _window_start(t, half, part), high - low
        for j, column in enumerate(q.T):
            around = sliding_window_view(column, size)[at]
            deviation = around @ change[0] if one_kernel else np.einsum("bs,bs->b", around, change)
            total[j] += float(deviation @ deviation)
        gains += [float(np.square(kernel).sum() / len(kernel) * len(part)) for kernel in (low, change)]
    return total / len(rows), float(gains[1] / gains[0])


def window_spans(t: Array, half: int) -> Array:
    """Return the time (N) that the window of each sample takes, s."""
    starts = _window_start(t, half, np.arange(len(t)))
    return np.asarray(t[starts + 2 * half] - t[starts])


WINDOW_STEP = 1.1  # from one window that is tried to the next
MAX_LOWER_RATIO = 0.7  # times the squares, which a window twice as wide divides by 32 where they are noise
MAX_DIFFERENCE_RATIO = 10.0  # times the least difference: windows that are wider still need not be tried
MAX_WINDOW_SHARE = 1 / 3  # of a log
# at which a window is tried: at most so many, or so many of each window
MAX_TRIAL_SAMPLES, SAMPLES_PER_WINDOW = 1000, 10
MAX_WINDOW_STRETCH = 1.5  # times the usual time of a window, from which on there is a gap in it
Order = Annotated[int, Ge(2), Le(10)]
Factor = Annotated[float, Gt(0)]


@dataclass(frozen=True)
class SavitzkyGolay(Smoother):
    """Fit a polynomial to the samples around each sample, and take q, dq and ddq from it; Savitzky and Golay (1964).

    ``window`` (s) is the time of an odd number of samples, one number or a mapping by joint name. None takes, for each
    joint, ``factor`` times the window that is best for ddq: about that at which polynomials of ``order`` and of
    ``order`` + 2 differ least, which is the error of the first by what it cannot follow, and by noise. A window of inf
    is that of a joint at rest. Times are taken as they are; masked out are samples whose window has a gap, so that it
    takes more than 1.5 times as long, and those within half a window of the ends.

    Calling it returns a ``Motion``. Raises ConfigError for bad settings or unknown joints, and InputError where the log
    is too short, or the window for its samples.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> q = np.sin(t) + 1e-3 * np.random.default_rng(0).standard_normal(1001)
    >>> log = dy.Log(t, q[:, None], tau=np.cos(t)[:, None], joints=("hinge",))
    >>> motion = dy.SavitzkyGolay()(log)
    >>> print(f"window {motion.smoothing['window'][0]:.2f} s, {motion.mask.sum()} samples usable")
    window 2.02 s, 799 samples usable
    >>> print(f"error of the velocity {np.abs(motion.dq[:, 0] - np.cos(t))[motion.mask].max():.4f} rad/s")
    error of the velocity 0.0024 rad/s
    """

    window: Annotated[float | Mapping[str, float] | None, BY_JOINT] = None  # inf, too
    order: Order = 4
    factor: Factor = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for window in self.window.values() if isinstance(self.window, Mapping) else (self.window,):
            if window is not None and not window > 0:
                raise ConfigError(f"window is {window}: give a positive time in s.")

    @property
    def method(self) -> str:
        """The method in words."""
        factor_text = "" if self.factor == 1.0 or self.window is not None else f", {self.factor:.3g} times the window"
        return f"Savitzky-Golay, polynomials of order {self.order}{factor_text}"

    def __call__(self, log: Log) -> Motion:
        """Fit; ``smoothing`` holds per joint the window (s) and the noise (rad, m)."""
        halves = self._half_windows(log)
        motion, noise, still = self._fit_windows(log, halves)
        step = float(np.median(np.diff(log.t)))
        windows = [np.inf if rests else 2 * half * step for half, rests in zip(halves, still, strict=True)]
        smoothing = {"method": self.method, "window": tuple(windows), "noise": tuple(noise.tolist())}
        widest = max((half for half, rests in zip(halves, still, strict=True) if not rests), default=1)
        mask = _has_full_window(log.t, widest)
        if not mask.any():
            raise InputError(f"{log.source}: every window of {2 * widest + 1} samples has a gap in it; smooth less.")
        return make_motion(log, motion, mask, smoothing, still)

    def as_used(self, motion: Motion) -> SavitzkyGolay:
        """Return the smoother with the window, for each joint, that it has used for a motion."""
        return SavitzkyGolay(dict(zip(motion.joints, motion.smoothing["window"], strict=True)), self.order)

    def _fit_windows(self, log: Log, halves: list[int]) -> tuple[tuple[Array, Array, Array], Array, NDArray[np.bool_]]:
        """Return q, dq, ddq (N, n), the noise (n), and which joints rest, those with an infinite window among them."""
        out, noise = np.empty((3, *log.q.shape)), np.zeros(len(halves))
        for half in set(halves) - {0}:
            joints = np.flatnonzero(np.array(halves) == half)
            *channels, trace = fit_polynomials(log.t, log.q[:, joints], half, self.order)
            out[:, :, joints] = channels
            inner = _has_full_window(log.t, half)
            # where no window is free of gaps, the noise is taken from all samples
            residual = (log.q[:, joints] - channels[0])[inner if inner.any() else slice(None)]
            noise[joints] = np.sqrt(np.square(residual).mean(axis=0) / max(1.0 - trace / len(log), 1e-3))
        resting = np.array(halves) == 0
        out[0][:, resting], noise[resting] = 0.0, np.std(log.q[:, resting], axis=0)
        return (out[0], out[1], out[2]), noise, at_rest(log.q, out[0], noise) | resting

    def _half_windows(self, log: Log) -> list[int]:
        """Return the number of samples (n) of a window on either side; 0 where the window is infinite."""
        min_half = (self.order + 2) // 2
        if len(log) < 2 * min_half + 1:
            raise InputError(
                f"{log.source}: {len(log)} samples are too few for polynomials of order {self.order}, which need "
                f"{2 * min_half + 1}."
            )
        windows = self.by_joint("window", log)
        halves = self._choose_halves(log, min_half) if None in windows else [0] * len(windows)
        return [
            half if window is None else self._half_window(log, window, min_half)
            for half, window in zip(halves, windows, strict=True)
        ]

    def _half_window(self, log: Log, window: float, min_half: int) -> int:
        step = float(np.median(np.diff(log.t)))
        if window == np.inf:
            return 0
        half = round(min(window / step / 2, float(len(log))))
        if half < min_half:
            raise InputError(
                f"{log.source}: a window of {window:.3g} s holds {2 * half + 1} samples; polynomials of order "
                f"{self.order} need at least {2 * min_half + 1}, {2 * min_half * step:.3g} s, or leave the window out."
            )
        if 2 * half + 1 > len(log):
            raise InputError(
                f"{log.source}: {len(log)} samples, {log.t[-1] - log.t[0]:.3g} s, are too short for a window of "
                f"{window:.3g} s; give a smaller one, or leave it out."
            )
        return half

    def _choose_halves(self, log: Log, min_half: int) -> list[int]:
        """Return the half window (n) that is best for ddq, times the factor.

        The squared difference of two orders is a W^(2 s) + k b W^-5 over the window W, with the even order s <=
        order, k times the variance of the lower one. It is least k^(1 / (2 s + 5)) above the window of the least
        error. Where both orders miss a motion they agree on it: the first window counts that no wider one improves
        on.
        """
        longest = max(min_half, (int(MAX_WINDOW_SHARE * len(log)) - 1) // 2)
        trials, half = [], min_half + 1
        while half <= longest:
            inside = np.flatnonzero(_has_full_window(log.t, half))
            if not len(inside):
                break
            # a wide window needs fewer rows: neighbouring ones tell nearly the same
            count = max(100, int(SAMPLES_PER_WINDOW * len(inside) / (2 * half + 1)))
            count = min(MAX_TRIAL_SAMPLES, count, len(inside))
            rows = inside[np.linspace(0, len(inside) - 1, count).astype(np.intp)]
            squares, gain = order_differences(log.t, log.q, half, (self.order, self.order + 2), rows)
            # the smallest difference lies a known factor above the best window (see above)
            trials.append((half * gain ** (-1 / (2 * (self.order // 2 * 2) + 5)), squares))
            if (squares > MAX_DIFFERENCE_RATIO * np.min([part for _, part in trials], axis=0)).all():
                break
            half = max(half + 1, int(WINDOW_STEP * half))
        if not trials:
            return [min_half] * log.q.shape[1]
        widths, squares = (np.array(part) for part in zip(*trials, strict=True))
        best = (widths[_first_minimum(widths, column)] for column in squares.T)
        return [max(round(min(self.factor * float(width), float(longest))), min_half) for width in best]

    def __str__(self) -> str:
        words = f"Savitzky-Golay polynomials of order {self.order}"
        if self.window is not None:
            return f"{words}, window{'s' * isinstance(self.window, Mapping)} {setting_text(self.window)} s"
        times = f", {setting_text(self.factor)} times the window best for ddq"
        return words + times * (self.factor != 1.0)


def _first_minimum(widths: Array, squares: Array) -> int:
    """Return the index of the first window (K) whose squares no wider one, up to twice as wide, lowers much."""
    for i, width in enumerate(widths):
        wider = squares[i + 1 :][widths[i + 1 :] <= 2.0 * width]
        if not len(wider) or wider.min() > MAX_LOWER_RATIO * squares[i]:
            # of windows that are about as good, within a factor of sqrt 2, take the minimum
            return i + int(np.argmin(squares[i:][widths[i:] <= np.sqrt(2.0) * width]))
    return len(widths) - 1


def _has_full_window(t: Array, half: int) -> NDArray[np.bool_]:
    """Return which samples (N) have half a window on either side, and no gap in it."""
    inside = np.zeros(len(t), dtype=bool)
    inside[half : len(t) - half] = True
    return np.asarray(inside & (window_spans(t, half) <= MAX_WINDOW_STRETCH * 2 * half * float(np.median(np.diff(t)))))
