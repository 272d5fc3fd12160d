"""The least torque error that white noise of the sensors leaves, whatever the model.

The torque's noise is that of differences of neighbouring samples; the positions' is what the spline left, passed
through its frequency response 1 / (1 + (w b)^4), b its bandwidth, and the derivatives of the torque by the motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.log import Motion, subsample
from dynident.models import Model
from dynident.splines import steady_noise

__all__ = ["sensor_noise"]

Array = NDArray[np.float64]
COLOURED = 2.0  # times the noise of all samples, that of every second: white noise has 1, after a first-order low-pass
# at 0.6 of half the sampling rate 2; the noise of all samples is then half of what it was
STATES = 200  # at which the torque is differentiated
LINES = 500  # frequencies


def sensor_noise(model: Model, theta: ArrayLike, motion: Motion) -> dict[str, float]:
    """Return by joint the rms torque error (N m, N) that white noise of its torque and of all positions leaves.

    Noise that is not white does not count, nor does that of positions which no spline has smoothed. A joint is missing
    where the noise of its torque is not known, as its spectrum falls up to half the sampling rate: every second sample
    shows far more noise than all do. Then the torque was filtered before it was recorded, or has no noise.
    """
    tau = motion.tau[motion.mask]
    if len(tau) < 20:
        return {}
    once, twice = (_noise(tau, step) for step in (1, 2))
    known = (once > 0) & (twice < COLOURED * once)
    if not known.any():
        return {}
    size = np.hypot(once, _of_positions(model, np.asarray(theta, dtype=float), motion))
    return {joint: float(x) for joint, x, is_known in zip(motion.joints, size, known, strict=True) if is_known}


def _noise(tau: Array, step: int) -> Array:
    """Return the noise (n) of every ``step``-th sample, zero where it is rounding."""
    found = np.sqrt(np.mean([steady_noise(tau[k::step], 1e-300) ** 2 for k in range(step)], axis=0))
    return np.asarray(np.where(found > 1e-9 * np.abs(tau).max(axis=0), found, 0.0))


def _of_positions(model: Model, theta: Array, motion: Motion) -> Array:
    """Return the rms torque (n) that the noise of the positions makes in the smoothed motion.

    With the derivatives A, B, C of the torque by q, dq, ddq and noise sigma in steps of h, its variance is
    sum_k sigma_k^2 h / pi int ((A - C w^2)^2 + B^2 w^2) / (1 + (w b_k)^4)^2 dw, up to pi / h; of a process of order m
    the power is 2 m.
    """
    if not {"noise", "bandwidth"} <= motion.smoothing.keys():
        return np.zeros(len(motion.joints))
    sigma, width = (np.array(motion.smoothing[name], dtype=float) for name in ("noise", "bandwidth"))
    power = 2 * int(str(motion.smoothing.get("order", 2)))
    slopes = model.partials(**motion.states(subsample([motion], STATES)[0]), theta=theta)
    step = float(np.diff(motion.t).mean())
    moments = np.zeros((3, len(sigma)))
    for k in np.flatnonzero(np.isfinite(width) & np.isfinite(sigma)):  # a joint at rest is smoothed without limit
        top = min(np.pi / step, 4.0 / max(width[k], 1e-300))
        w = (np.arange(LINES) + 0.5) * top / LINES
        passed = (1.0 + (w * width[k]) ** power) ** -2
        moments[:, k] = [sigma[k] ** 2 * step / np.pi * top / LINES * (w**m * passed).sum() for m in (0, 2, 4)]
    A, B, C = slopes.q, slopes.dq, slopes.ddq
    variance = A**2 * moments[0] + (B**2 - 2.0 * A * C) * moments[1] + C**2 * moments[2]
    return np.asarray(np.sqrt(np.maximum(variance.sum(axis=2).mean(axis=0), 0.0)))
