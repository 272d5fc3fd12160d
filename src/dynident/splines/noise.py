"""The standard deviation of noise, from the data alone: one estimate for each purpose.

``noise_sigma`` is for smooth signals, positions above all: efficient, at uneven times, but sensitive to jumps.
``steady_noise`` is for torques and other signals that may step: its median ignores the few samples around a jump.
``median_sigma`` is for residuals with outliers or transients. From the residuals of a fit and its degrees of freedom,
the noise is ``SmoothingSpline.noise``; maximum likelihood has its own estimate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import InputError

__all__ = ["NORMAL_95", "median_sigma", "noise_sigma", "steady_noise"]

NORMAL_95 = 1.959964  # standard deviations to each side that hold 95 % of a normal distribution
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
    count = len(time) - order
    position = np.lib.stride_tricks.sliding_window_view(time, order + 1)
    coefficients = np.ones((order + 1, count))
    for i in range(order + 1):
        for j in range(order + 1):
            if i != j:
                coefficients[i] /= (position[:, i] - position[:, j]) / (position[:, -1] - position[:, 0])
    weight = np.ones((len(time), 1)) if weights is None else np.asarray(weights, float).reshape(len(time), -1)
    difference, variance = np.zeros((count, data.shape[1])), np.zeros((count, weight.shape[1]))
    for i in range(order + 1):
        difference += coefficients[i][:, None] * data[i : i + count]
        variance += coefficients[i][:, None] ** 2 / weight[i : i + count]
    found = np.sqrt(np.mean(difference**2 / variance, axis=0))
    rounding = 4 * np.finfo(float).eps * np.abs(data).max(axis=0)
    return np.asarray(np.maximum(found, np.maximum(rounding, 1e-100)))


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
