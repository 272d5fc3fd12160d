"""The standard deviation of noise, from the data alone: one estimate for each purpose.

``noise_sigma`` is for smooth signals, positions above all: efficient, at uneven times, but sensitive to jumps.
``steady_noise`` is for torques and other signals that may step: its median ignores the few samples around a jump.
``coloured_noise`` is for positions whose noise may be correlated, after they have been smoothed.
``median_sigma`` is for residuals with outliers or transients. From the residuals of a fit and its degrees of freedom,
the noise is ``SmoothingSpline.noise``; maximum likelihood has its own estimate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import InputError
from dynident.splines.compiled import roughness, survey

__all__ = ["NORMAL_95", "coloured_noise", "median_sigma", "noise_sigma", "steady_noise"]

Array = NDArray[np.float64]
NORMAL_95 = 1.959964  # standard deviations to each side that hold 95 % of a normal distribution
ROOT = np.sqrt(2.0) - 1.0  # (2 pi f bandwidth)^(2 order) at the cut-off
FREQUENCIES, FEWEST = 4000, 20
MEDIAN = 1.4826  # standard deviation of a normal distribution over the median of its absolute value


def noise_sigma(t: ArrayLike, y: ArrayLike, weights: ArrayLike | None = None, *, order: int = 4) -> NDArray[np.float64]:
    """Estimate the noise standard deviation of each column from divided differences on the actual times.

    ``t`` (N) increasing, ``y`` (N,) or (N, k), ``weights`` None, (N,) or (N, k): a sample's standard deviation is
    sigma / sqrt(weight). Returns sigma (k,), in the unit of y. The divided difference of ``order``
    over neighbouring samples removes a polynomial of lower degree; divided by the norm of its coefficients it has the
    variance of the noise. The estimate is its root mean square (Gasser, Sroka and Jennen-Steinmetz, 1986, for order 2
    and a non-uniform design; Hall, Kay and Titterington, 1990, for higher orders).

    Limits: the noise must be white. The error of a quantised encoder is neither white nor Gaussian: it is constant at
    rest and follows the motion at low speed, so that the estimate is too small there; coloured noise (a filter in the
    drive) is underestimated too. With too low a sampling rate the signal's own differences add to it, and the estimate
    is too large. It is at least the rounding of the data, 4 eps max |y|. Raises InputError for fewer than order + 2
    samples.
    """
    time = np.asarray(t, dtype=float)
    data = np.asarray(y, dtype=float).reshape(len(time), -1)
    if len(time) < order + 2:
        raise InputError(f"estimating the noise needs at least {order + 2} samples, got {len(time)}.")
    weight = np.ones((len(time), 1)) if weights is None else np.asarray(weights, float).reshape(len(time), -1)
    squares = roughness(time, data, weight) if order == 4 else None
    found = np.sqrt(_roughness(time, data, weight, order) if squares is None else squares)
    low, high, _ = survey(np.ascontiguousarray(data))
    rounding = 4 * np.finfo(float).eps * np.maximum(high, np.negative(low))
    return np.asarray(np.maximum(found, np.maximum(rounding, 1e-100)))


def _roughness(time: Array, data: Array, weight: Array, order: int) -> Array:
    """Return the mean squares of divided differences, each over its variance."""
    count = len(time) - order
    position = np.lib.stride_tricks.sliding_window_view(time, order + 1)
    coefficients = np.ones((order + 1, count))
    for i in range(order + 1):
        for j in range(order + 1):
            if i != j:
                coefficients[i] /= (position[:, i] - position[:, j]) / (position[:, -1] - position[:, 0])
    difference, variance = np.zeros((count, data.shape[1])), np.zeros((count, weight.shape[1]))
    for i in range(order + 1):
        difference += coefficients[i][:, None] * data[i : i + count]
        variance += coefficients[i][:, None] ** 2 / weight[i : i + count]
    return np.asarray(np.mean(difference**2 / variance, axis=0))


def coloured_noise(
    t: ArrayLike, y: ArrayLike, left: ArrayLike, bandwidth: ArrayLike, order: int = 2
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return deviation (k) and correlation of neighbours (k, 0 to 0.98) of the noise in y (N, k), taken as AR(1).

    ``left`` (N, k) is what splines of these bandwidths (k, s), of degree 2 ``order`` - 1, have smoothed away. Its
    spectrum is compared with that of AR(1) (Whittle's likelihood) above twice the cut-off, where it is noise alone, and
    nearly all of it. Where too few frequencies are left, nothing was smoothed away, or the spectrum is none of AR(1),
    the noise is that of ``noise_sigma``, and white.
    """
    time, rest, width = (np.asarray(x, dtype=float) for x in (t, left, bandwidth))
    sigma, rho = noise_sigma(time, y), np.zeros(rest.shape[1])
    step = float(time[-1] - time[0]) / (len(time) - 1)
    trial = np.linspace(0.0, 0.98, 99)
    power = np.square(np.abs(np.fft.rfft(rest * np.hanning(len(rest))[:, None], axis=0)))
    power /= np.square(np.hanning(len(rest))).sum()
    angle = 2 * np.pi * np.arange(len(power)) / len(rest)
    for k in np.flatnonzero(np.isfinite(width) & (sigma > 0)):  # a joint that stands still is smoothed without limit
        lost = (angle * width[k] / step) ** (2 * order)
        used = np.flatnonzero(lost > 4.0**order * ROOT)
        used = used[:: max(1, len(used) // FREQUENCIES)]
        if len(used) < FEWEST or not power[used, k].any():
            continue
        clean = power[used, k] * (1 + 1 / lost[used]) ** 2
        shape = 1 + trial[:, None] ** 2 - 2 * trial[:, None] * np.cos(angle[used])
        fresh = (clean * shape).mean(axis=1)
        best = int(np.argmin(np.log(fresh) - np.log(shape).mean(axis=1)))
        if best == len(trial) - 1:  # not noise, but motion that was smoothed away
            continue
        sigma[k], rho[k] = np.sqrt(fresh[best] / (1 - trial[best] ** 2)), trial[best]
    return sigma, rho


def median_sigma(x: ArrayLike) -> NDArray[np.float64]:
    """Return the standard deviation (k) of x (N, k), normal about zero with outliers, from median absolute values."""
    return np.asarray(MEDIAN * np.median(np.abs(np.asarray(x, dtype=float)), axis=0))


def steady_noise(x: NDArray[np.float64], least: float, order: int = 4) -> NDArray[np.float64]:
    """Return the noise's standard deviation (k) of evenly sampled x (N, k), from the median of its differences.

    The median ignores the few samples after a step. White noise is assumed. The result is at least ``least`` times the
    channel's largest value, or where that is zero, the largest value of all channels.
    """
    coefficients = np.array([1.0])
    for _ in range(order):
        coefficients = np.convolve(coefficients, [1.0, -1.0])
    found = median_sigma(np.diff(x, order, axis=0)) / np.linalg.norm(coefficients)
    size = np.abs(x).max(axis=0)
    return np.asarray(np.maximum(found, least * np.where(size > 0, size, size.max() or 1.0)))
