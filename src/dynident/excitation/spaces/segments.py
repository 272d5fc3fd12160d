"""The nearest points of line segments to each other, and to convex bodies, as smooth functions of where these are.

The nearest points of parallel segments are not unique, and jump where a motion passes through parallel. Here a small
preference for the middle of a segment makes them continuous, so that distances have continuous derivatives; what it
adds is taken off, so that a distance is never more than the true one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["between", "to_body"]

Array = NDArray[np.float64]
Signed = Callable[[Array], tuple[Array, Array]]
SQUARED = 1e-4  # m^2: preference between segments; where they are 0.1 m apart, it costs at most 0.25 mm
LINEAR = 2e-3  # m: preference beside a body; it costs at most a quarter
TINY = 1e-300
HALVINGS = 20  # of a segment


def between(p: Array, u: Array, r: Array, v: Array) -> tuple[Array, Array, Array]:
    """Return the distance (...) in m of segments from p along u to those from r along v, all (..., 3); a point (..., 3)
    on each of the first, and the derivative (..., 3) by it, which is minus that by the point on the second.

    The points p + s u and r + t v minimise d^2 + SQUARED ((s - 1/2)^2 + (t - 1/2)^2), of which at most SQUARED / 2 is
    not d^2. Where d is below 10 mm, the tangent replaces the square root, which has no derivative at zero.
    """
    w = p - r
    a, e, b = _dot(u, u) + SQUARED, _dot(v, v) + SQUARED, _dot(u, v)
    c, f = _dot(u, w) - SQUARED / 2, _dot(v, w) + SQUARED / 2
    s = np.clip((b * f - c * e) / (a * e - b * b), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    one = p + s[..., None] * u
    away = one - r - t[..., None] * v
    value = _dot(away, away) + SQUARED * ((s - 0.5) ** 2 + (t - 0.5) ** 2)
    root = np.sqrt(np.maximum(value, SQUARED) - SQUARED / 2)
    return root + np.minimum(value - SQUARED, 0.0) / (2 * root), one, away / root[..., None]


def to_body(p: Array, u: Array, signed: Signed) -> tuple[Array, Array, Array]:
    """Return the distance (...) in m of segments from p along u (..., 3) to a convex body, a point (..., 3) on each,
    and the derivative (..., 3) by it.

    ``signed`` gives the distance of points, negative inside, and its derivative. As it is convex along a segment, the
    nearest part s is where the slope of distance + LINEAR (s - 1/2)^2 changes its sign: between two parts close to each
    other, of which the tangents then give the rest. Where the slope jumps, as inside a box, the derivative is the mean
    of those on both sides at which it is zero.
    """
    low, high = np.zeros(p.shape[:-1]), np.ones(p.shape[:-1])
    for _ in range(HALVINGS):
        s = (low + high) / 2
        rising = _dot(signed(p + s[..., None] * u)[1], u) + 2 * LINEAR * (s - 0.5) > 0
        low, high = np.where(rising, low, s), np.where(rising, s, high)
    first, before, falling = _valued(p, u, low, signed)
    last, after, rise = _valued(p, u, high, signed)
    share = np.clip(-falling / np.maximum(rise - falling, TINY), 0.0, 1.0)
    width = high - low
    first, last = first + falling * share * width, last - rise * (1 - share) * width
    point = p + (low + share * width)[..., None] * u
    return first + share * (last - first), point, before + share[..., None] * (after - before)


def _valued(p: Array, u: Array, s: Array, signed: Signed) -> tuple[Array, Array, Array]:
    """Return distance and preference at the parts s, the derivative of the distance, and the slope of both by s."""
    distance, normal = signed(p + s[..., None] * u)
    return distance + LINEAR * ((s - 0.5) ** 2 - 0.25), normal, _dot(normal, u) + 2 * LINEAR * (s - 0.5)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))
