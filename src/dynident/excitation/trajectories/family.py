"""Families of motions that are linear in their coefficients: what the optimiser chooses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.excitation.trajectories.trajectory import Course

__all__ = ["Family", "Guard", "LinearCourse"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Guard:
    """Finitely many linear constraints that keep a motion within limits at all times.

    ``rows`` are four matrices (R, K), for q, dq, ddq and jerk. Where ``rows[d] @ x`` stays within middle +- ``share`` *
    half, the derivative d of the motion of coefficients x stays within middle +- half, at all times.
    """

    rows: tuple[Array, Array, Array, Array]
    share: float

    __repr__ = brief


class Family(Protocol):
    """Motions q(t) = sum_k B_k(t) x_k, for each joint with its own K coefficients x (n, K).

    ``Fourier`` (periodic) and ``Clamped`` (B-splines at rest at both ends) are such. The first coefficient is a pose:
    the others do not change when it shifts the whole motion.
    """

    @property
    def size(self) -> int:
        """The number K of coefficients of a joint."""

    @property
    def duration(self) -> float:
        """The length (s): one period, or the whole."""

    def values(self, t: Array, /) -> Array:
        """Return the functions and their first three derivatives, shape (4, N, K), at times t (N)."""

    def guard(self, points: int, /) -> Guard:
        """Return the constraints that keep a motion within limits; the more ``points``, the less is given away."""

    def course(self, x: Array, /) -> Course:
        """Return the motion of coefficients x (n, K), once through."""


@dataclass(frozen=True, eq=False)
class LinearCourse:
    """The motion of a family with coefficients ``x`` (n, K), once through."""

    family: Family
    x: Array

    __repr__ = brief

    @property
    def duration(self) -> float:
        """Its length (s)."""
        return self.family.duration

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        return np.asarray(self.family.values(t) @ self.x.T)
