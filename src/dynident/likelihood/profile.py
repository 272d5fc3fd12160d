"""Ends of 95 % intervals by profile likelihood: where the best fit with one parameter held there is too unlikely."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["LIMIT", "crossing", "swept"]

Array = NDArray[np.float64]
LIMIT = 1.959964  # of a normal deviate, for 95 %
LONGEST = 6.0  # of the search for the end of an interval, in the parameter's logarithm
NEAR = 0.15  # relative distance from the limit from which on a curve through the points known will do
TRIALS = 6


def crossing(deviation: Callable[[float], float], size: float) -> float:
    """Return where ``deviation(x)``, the root of the deviance at x > 0, reaches the limit of 95 %.

    At zero it is zero with the slope 1 / ``size``. The root of a deviance is nearly straight: parabolas through zero
    lead to the crossing. Where it stays low, the last x is returned. A deviation of nan says that x cannot be tried.
    """
    x, known = LIMIT * size, [(0.0, 1.0 / size)]  # where, and the deviation's ratio to x
    for _ in range(TRIALS):
        found = deviation(x)
        if np.isnan(found):
            x = 0.5 * (x + known[-1][0])
            continue
        known.append((x, found / x))
        x, before = _parabola(known[-2], known[-1]), x
        if abs(found / LIMIT - 1) < NEAR or before >= LONGEST:
            break
    return min(x, LONGEST)


def _parabola(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Return where x times the straight line through two (x, ratio) is the limit; twice as far where it never is."""
    bend = (other[1] - one[1]) / (other[0] - one[0]) if other[0] != one[0] else 0.0
    start = other[1] - bend * other[0]
    inside = start**2 + 4 * bend * LIMIT
    found = 2 * LIMIT / (start + np.sqrt(inside)) if inside > 0 and start + np.sqrt(inside) > 0 else np.inf
    return float(np.clip(found, 0.3 * other[0], min(2.5 * other[0], LONGEST)))


def swept(path: Array, deviations: Array, covariance: Array, k: int) -> Array:
    """Return 95 % intervals (p, 2) of all parameters, from the profile likelihood of parameter k.

    ``path`` (T, p) are the best fits with parameter k held, ``deviations`` (T) the signed roots of their deviance, from
    the first end of its interval to the last. What is left of the likelihood at each point of the path is taken as
    normal: a parameter that follows k along a bent valley bends with it; one that does not has 1.96 standard errors.
    """
    along = covariance[:, k] / np.sqrt(covariance[k, k])
    rest = np.sqrt(np.maximum(np.diag(covariance) - along**2, 0.0))
    fine = np.linspace(-LIMIT, LIMIT, 81)
    degree = min(len(deviations) - 1, 3)
    scale = np.maximum(np.abs(path).max(axis=0), 1e-300)
    middle = np.polynomial.polynomial.polyfit(deviations, path / scale, degree)
    centre = np.polynomial.polynomial.polyval(fine, middle).T * scale
    reach = np.sqrt(LIMIT**2 - fine**2)[:, None] * rest
    return np.stack([(centre - reach).min(axis=0), (centre + reach).max(axis=0)], axis=1)
