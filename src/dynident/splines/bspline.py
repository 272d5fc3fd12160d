"""B-splines and their derivatives, by the recursion of Cox and de Boor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["local_basis"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def local_basis(knots: Array, degree: int, m: Index, t: Array) -> Array:
    """Return values, first and second derivatives (3, N, degree + 1) of the B-splines that act on times t (N).

    ``m`` (N) is the interval of each time, knots[m] <= t <= knots[m + 1]; the splines m - degree ... m act there.
    ``degree`` is at least 2. De Boor (1978), "A practical guide to splines", chapter X.
    """
    values = [np.ones((len(t), 1))]
    for k in range(1, degree + 1):
        values.append(_raised(values[-1], knots, k, m, t))
    slope = _derived(values[degree - 1], knots, degree, m)
    bend = _derived(_derived(values[degree - 2], knots, degree - 1, m), knots, degree, m)
    return np.stack([values[degree], slope, bend])


def _raised(lower: Array, knots: Array, degree: int, m: Index, t: Array) -> Array:
    """Return the values (N, degree + 1) from those of one degree less."""
    out = np.zeros((len(t), degree + 1))
    for a in range(degree):
        left, right = knots[m - degree + 1 + a], knots[m + 1 + a]
        share = lower[:, a] / (right - left)
        out[:, a] += (right - t) * share
        out[:, a + 1] += (t - left) * share
    return out


def _derived(lower: Array, knots: Array, degree: int, m: Index) -> Array:
    """Return the derivatives (N, degree + 1) from what is differentiated, of one degree less."""
    out = np.zeros((len(lower), degree + 1))
    for a in range(degree):
        share = degree * lower[:, a] / (knots[m + 1 + a] - knots[m - degree + 1 + a])
        out[:, a] -= share
        out[:, a + 1] += share
    return out
