"""The standard deviation of measurement noise, from the data alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import InputError

__all__ = ["noise_sigma"]


def noise_sigma(t: ArrayLike, y: ArrayLike, weights: ArrayLike | None = None, *, order: int = 4) -> NDArray[np.float64]:
    """Estimate the noise standard deviation of each column from divided differences on the actual times.

    ``t`` (N) increasing, ``y`` (N,) or (N, k), ``weights`` None, (N,) or (N, k): a sample's standard deviation is
    sigma / sqrt(weight). Returns sigma (k,), in the unit of y. The divided difference of ``order``
    over neighbouring samples removes a polynomial of lower degree; divided by the norm of its coefficients it has the
    variance of the noise. The estimate is its root mean square (Gasser, Sroka and Jennen-Steinmetz, 1986, for order 2
    and a non-uniform design; Hall, Kay and Titterington, 1990, for higher orders).

    Limits: the noise must be white. A quantised encoder's error is neither white nor gaussian: it stands still with
    the joint and follows the motion at low speed, so that the estimate is too small there; coloured noise (a filter in
    the drive) is under-estimated too. Too slow a sampling adds the signal's own differences: it is then too large.
    It is never less than the rounding of the data, 4 eps max |y|.
    Raises InputError for fewer than order + 2 samples.
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
