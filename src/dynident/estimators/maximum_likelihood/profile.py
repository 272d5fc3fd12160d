"""Ends of 95 % intervals by profile likelihood: where the best fit with one parameter fixed becomes too unlikely."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.splines import NORMAL_95

__all__ = ["crossing", "swept"]

Array = NDArray[np.float64]
LONGEST = 6.0  # of the search for the end of an interval, in the parameter's logarithm
NEAR = (0.6, 2.0)  # share of the limit between which the curve through the points known will do
TRIALS = 6
TELLING = 0.5  # root of the deviance below which a best fit says little about the curvature of the path


def crossing(root: Callable[[float], tuple[float, float]], size: float, side: int) -> float:
    """Return the share y of the estimate, 0 ... 1 for ``side`` -1 or above for 1, where the 95 % interval ends.

    ``root(y)`` is the root of the deviance at the share y, signed like ``side``, and its slope; at one it is zero, with
    the slope 1 / ``size``. Where it stays low, the last y is returned. A root of nan says that y cannot be tried: the
    end is not beyond.
    """
    aim, last = side * NORMAL_95, float(np.exp(side * LONGEST))
    low, high = sorted((1.0, last))
    y = float(np.clip((1 + 0.5 * aim * size) ** 2 if side > 0 else np.exp(aim * size), low, high))
    known = [(0.0, 1.0, size)]  # the root, y, and its slope by the root
    for _ in range(TRIALS):
        found, slope = root(y)
        if np.isnan(found):
            low, high = sorted((1.0, y))
            y = float(np.sqrt(y * known[-1][1]))
            continue
        known.append((found, y, 1 / slope if slope > 0 else np.inf))
        before, y = y, float(np.clip(_reached(known[-2], known[-1], aim), low, high))
        if NEAR[0] < found / aim < NEAR[1] or before == last:
            break
        y = float(np.clip(y, *sorted((before**0.3, before**2.5))))
        if y in (low, high) and y != last:  # where it has failed
            y = float(np.sqrt(y * before))
    return y


def _reached(one: tuple[float, float, float], other: tuple[float, float, float], x: float) -> float:
    """Return y at x from points (x, y, dy / dx): on the cubic through both, or beyond the other.

    There it goes straight down, or up exponentially: what bends less has been passed by the first trial.
    """
    (a, ya, sa), (b, yb, sb) = one, other
    if (x - b) * (b - a) >= 0 or not np.isfinite(sb):
        along = (x - b) * sb
        return yb + along if along < 0 else yb * float(np.exp(min(along / yb, LONGEST)))
    chord = (yb - ya) / (b - a)
    if not np.isfinite(sa):
        return ya + (x - a) * chord
    first, last = (chord - sa) / (b - a), (sb - chord) / (b - a)
    return ya + (x - a) * (sa + (x - a) * (first + (x - b) * (last - first) / (b - a)))


def swept(theta: Array, path: Sequence[tuple[float, Array]], covariance: Array, k: int) -> Array:
    """Return 95 % intervals (p, 2) of all parameters, from the profile likelihood of parameter k.

    ``path`` are, besides the estimate ``theta`` (p), signed roots of the deviance and the best fits (p) with parameter
    k held there. What is left of the likelihood at each point of the path is taken as normal: a parameter that follows
    k along a bent valley bends with it; one that does not has 1.96 standard errors. The path is a cubic, and leaves the
    estimate as the covariance says; fits as likely as the estimate, but elsewhere, are left out.
    """
    along = covariance[:, k] / np.sqrt(covariance[k, k])
    rest = np.sqrt(np.maximum(np.diag(covariance) - along**2, 0.0))
    fine, powers = np.linspace(-NORMAL_95, NORMAL_95, 81)[:, None], np.array([2, 3])
    centre = theta + fine * along
    far = [pair for pair in path if abs(pair[0]) > TELLING]
    if far:
        r = np.array([[root] for root, _ in far])
        aside = np.array([found for _, found in far]) - theta - r * along
        centre += fine**powers @ np.linalg.lstsq(r**powers, aside, rcond=None)[0]
    reach = np.sqrt(NORMAL_95**2 - fine**2) * rest
    return np.stack([(centre - reach).min(axis=0), (centre + reach).max(axis=0)], axis=1)
