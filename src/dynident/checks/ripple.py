"""The ripple of a joint's torque, which repeats with its position: cogging motors and errors of gears.

The period is that of the largest peak in the periodogram of the residual by position, improved by Gauss-Newton steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.checks.case import BAND
from dynident.checks.misfit import Misfit

__all__ = ["ripple"]

Array = NDArray[np.float64]
FEWEST, MOST = 3.0, 100.0  # periods within a joint's range: slower ones are springs and gravity
FINE = 0.25  # periods within the range, from one that is tried to the next
LIKELY = 0.1  # share of a joint's squared residual that a period must explain to be looked at closely
STEPS = 2


def ripple(fit: Misfit, j: int) -> tuple[float, Array] | None:
    """Return the period (rad or m) of a joint's largest ripple, and the ripple of unit size at the samples (M); None
    where none is likely. Ripples of more than half of ``BAND`` at the largest speed are not seen.
    """
    counted = fit.weight[:, j] > 0
    q, residual = fit.case.q[counted, j], fit.residual[counted, j]
    span = float(np.ptp(q)) if len(q) else 0.0
    if not span > 0 or not residual.any():
        return None
    fastest = float(np.abs(fit.case.dq[counted, j]).max())
    rates = 2 * np.pi / span * np.arange(FEWEST, min(MOST, BAND / 2 * span / (fastest or np.inf)), FINE)
    if not len(rates):
        return None
    power = _periodogram(q - q.mean(), residual, rates)
    if power.max() < LIKELY:
        return None
    rate = float(rates[int(np.argmax(power))])
    for _ in range(STEPS):
        column, step = _step(fit, j, rate)
        rate += float(np.clip(step, -FINE * 2 * np.pi / span, FINE * 2 * np.pi / span))
    column, _ = _step(fit, j, rate)
    return 2 * np.pi / rate, column


def _periodogram(q: Array, residual: Array, rates: Array) -> Array:
    """Return the share of a squared residual (M) that a ripple of each rate (1/rad or 1/m, uniform) explains."""
    turn, step = np.exp(1j * rates[0] * q) * residual, np.exp(1j * (rates[-1] - rates[0]) / max(len(rates) - 1, 1) * q)
    power = np.empty(len(rates))
    for k in range(len(rates)):
        power[k] = np.abs(turn.sum()) ** 2
        turn *= step
    return np.asarray(2.0 * power / (len(q) * np.square(residual).sum()))


def _step(fit: Misfit, j: int, rate: float) -> tuple[Array, float]:
    """Return the ripple of unit size (M) that explains the most at a rate, and the Gauss-Newton step of the rate."""
    q = fit.case.q[:, j]
    waves = np.array([np.sin(rate * q), np.cos(rate * q)])
    columns = np.zeros((4, *fit.residual.shape))
    columns[:, :, j] = *waves, *(q * waves)
    A, left = fit.beside(columns).reshape(4, -1).T, fit.residual.ravel()
    size = np.linalg.lstsq(A[:, :2], left, rcond=None)[0]
    slope = size[0] * A[:, 3] - size[1] * A[:, 2]  # by the rate
    step = np.linalg.lstsq(np.column_stack([A[:, :2], slope]), left, rcond=None)[0][2]
    return np.asarray(size @ waves / (np.linalg.norm(size) or 1.0)), float(step)
