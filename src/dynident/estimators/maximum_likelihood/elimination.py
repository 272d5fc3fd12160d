"""One segment of eq. (7) with its trajectory eliminated: what is left for the parameters, and the way back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.estimators.maximum_likelihood.arrow import Arrow
from dynident.estimators.maximum_likelihood.equations import Equations

__all__ = ["Elimination", "Quadratic"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Elimination:
    """A segment without its trajectory, then without its k torques after steps.

    ``information`` (r, r) and ``gradient`` (r) are what is left for the parameters of the border; ``fall`` is twice the
    fall of the cost that trajectory and torques alone promise. ``half`` (m n, b + 1) is L^-1 of the border and of minus
    the gradient, ``inner`` (k, 1 + r) gives the torques.
    """

    arrow: Arrow
    half: Array
    inner: Array
    information: Array
    gradient: Array
    fall: float

    @classmethod
    def of(cls, one: Equations, arrow: Arrow, r: int, *, mixed_hessian: bool = False) -> Elimination:
        """Return the elimination; ``arrow`` is the band with the whole ``side`` of the equations, which is solved once
        for steps with and without second derivatives."""
        b, half = len(one.corner), arrow.half
        k, whole = b - r, half[:, : b + 1]
        if mixed_hessian:
            whole = whole.copy()
            whole[:, k:b] += half[:, b + 1 :]
        lost = whole.T @ whole
        S, g = one.corner - lost[:b, :b], one.by_border - lost[:b, b]
        inner = np.asarray(np.linalg.solve(S[:k, :k], np.column_stack([g[:k], S[:k, k:]])))
        fall = float(lost[b, b] + g[:k] @ inner[:, 0])
        return cls(arrow, whole, inner, S[k:, k:] - S[k:, :k] @ inner[:, 1:], g[k:] - S[k:, :k] @ inner[:, 0], fall)

    def step(self, change: Array) -> tuple[Array, Array]:
        """Return the step of C (m n) and W (k) that goes with a ``change`` (r) of the parameters."""
        k = len(self.inner)
        dW = self.inner[:, 0] - self.inner[:, 1:] @ change
        b = k + len(change)
        x = self.half[:, b] - self.half[:, :b] @ np.concatenate([dW, change])
        return self.arrow.back(x[:, None])[:, 0], dW

    @cached_property
    def follow(self) -> Array:
        """Minus the dependence (m n + k, r) of C and W on the parameters."""
        k = len(self.inner)
        half = self.half[:, k:-1] - self.half[:, :k] @ self.inner[:, 1:]
        return np.concatenate([self.arrow.back(half), self.inner[:, 1:]])


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Information (r, r), gradient (r), and twice the fall that the trajectories alone promise, of all segments."""

    information: Array
    gradient: Array
    fall: float
    segments: tuple[Elimination, ...]

    @classmethod
    def of(cls, found: Sequence[Equations], arrows: Sequence[Arrow], r: int, *, mixed_hessian: bool) -> Quadratic:
        """Sum over the segments; ModelError where the equations are not finite."""
        pairs = zip(found, arrows, strict=True)
        parts = tuple(Elimination.of(one, arrow, r, mixed_hessian=mixed_hessian) for one, arrow in pairs)
        information = sum((one.information for one in parts), np.zeros((r, r)))
        if not np.isfinite(information).all():
            raise ModelError("the normal equations of the parameters are not finite.")
        return cls(
            information, sum((one.gradient for one in parts), np.zeros(r)), sum(one.fall for one in parts), parts
        )
