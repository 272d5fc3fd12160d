"""Products of vectors (3, ...) and matrices (3, 3, ...) whose components are arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["NEXT", "back", "cross", "diagonal", "dot", "outer", "product", "turn"]

Array = NDArray[np.float64]
NEXT = ((0, 1, 2), (1, 2, 0), (2, 0, 1))  # the even permutations of the components


def dot(a: Array, b: Array) -> Array:
    """Return a . b for vectors (3, ...)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    """Return a x b for vectors (3, ...), whose shapes may differ as NumPy allows."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in NEXT:
        np.subtract(a[j] * b[k], a[k] * b[j], out=out[i])
    return out


def turn(A: Array, b: Array) -> Array:
    """Return A b for matrices (3, 3, ...) and vectors (3, ...)."""
    out: Array = A[:, 0] * b[0]
    out += A[:, 1] * b[1]
    out += A[:, 2] * b[2]
    return out


def back(A: Array, b: Array) -> Array:
    """Return A' b for matrices (3, 3, ...) and vectors (3, ...)."""
    return turn(A.swapaxes(0, 1), b)


def product(A: Array, B: Array) -> Array:
    """Return A B for matrices (3, 3, ...)."""
    out: Array = A[:, 0, None] * B[0]
    out += A[:, 1, None] * B[1]
    out += A[:, 2, None] * B[2]
    return out


def outer(a: Array, b: Array) -> Array:
    """Return a b' (3, 3, ...) for vectors (3, ...)."""
    return np.asarray(a[:, None] * b[None])


def diagonal(x: Array) -> Array:
    """Return the unit matrix times x (...): (3, 3, ...)."""
    return np.asarray(np.eye(3).reshape(3, 3, *[1] * x.ndim) * x)
