"""Families of motions that are linear in their coefficients: what the optimiser chooses."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.trajectory import Course

__all__ = ["Family"]

Array = NDArray[np.float64]


class Family(Protocol):
    """Motions q(t) = sum_k B_k(t) x_k, for each joint with its own K coefficients x (n, K).

    ``Fourier`` (periodic) and ``Clamped`` (B-splines at rest at both ends) are such.
    """

    @property
    def size(self) -> int:
        """The number K of coefficients of a joint."""

    @property
    def duration(self) -> float:
        """The length (s): one period, or the whole."""

    def values(self, t: Array, /) -> Array:
        """Return the functions and their first three derivatives, shape (4, N, K), at times t (N)."""

    def bounds(self, grid: Array, /) -> Array:
        """Return by how much |q|, |dq|, |ddq| and the jerk may exceed their largest value on the ``grid`` (N), as
        numbers (4, K) for the sizes of the coefficients: excess <= bounds @ |x|."""

    def course(self, x: Array, /) -> Course:
        """Return the motion of coefficients x (n, K), once through."""
