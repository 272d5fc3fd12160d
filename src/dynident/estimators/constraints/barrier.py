"""A log-det barrier that keeps constrained matrices positive definite, and Newton's method inside it.

Boyd and Vandenberghe (2004), "Convex optimization", chapters 9 to 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from dynident.estimators.constraints.constraints import PsdConstraint

__all__ = ["Barrier", "Penalised"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]
INNER = 500  # steps at one weight of the barrier; usually a few, but many near the boundary for a thin body
SHORTEST = 1e-6  # share of a step below which the line search stops


@dataclass(frozen=True, eq=False)
class _Matrices:
    """Matrices of one size that depend on x[columns]: ``columns`` (c), ``slopes`` (K, c, s, s), ``offset`` (K, s, s).

    ``share`` (K) is the weight of each in the barrier.
    """

    columns: Index
    slopes: Array
    offset: Array
    share: Array

    @classmethod
    def of(cls, columns: Index, same: Sequence[PsdConstraint]) -> _Matrices:
        """Stack constraints on matrices of one size that depend on the same components of x."""
        slopes = np.concatenate([np.moveaxis(one.slopes[..., columns], -1, 1) for one in same])
        share = np.concatenate([np.full(len(one.slopes), 1.0 / len(one.slopes)) for one in same])
        return cls(columns, slopes, np.concatenate([one.constant for one in same]), share)

    @cached_property
    def flat(self) -> Array:
        """The slopes as (c, K s s)."""
        return np.swapaxes(self.slopes, 0, 1).reshape(len(self.columns), -1)

    def root(self, x: Array) -> Array:
        """Return the Cholesky factors (K, s, s) at x (v); LinAlgError outside."""
        return np.asarray(np.linalg.cholesky(self.offset + (x[self.columns] @ self.flat).reshape(self.offset.shape)))


def _columns(one: PsdConstraint) -> Index:
    """Return the components of x that a constraint depends on: all where they are many, to group it with others."""
    found = np.flatnonzero(np.abs(one.slopes).sum(axis=(0, 1, 2)))
    size = one.slopes.shape[-1]
    return found if 2 * len(found) < size else np.arange(size)


@dataclass(frozen=True, eq=False)
class Barrier:
    """``weight`` times the sum of -log det, or of log-det divergences, of the matrices (mean over the K)."""

    psd_constraints: tuple[PsdConstraint, ...] = ()
    weight: float = 1e-3

    @cached_property
    def _matrices(self) -> tuple[_Matrices, ...]:
        groups: dict[tuple[int, bytes], list[PsdConstraint]] = {}
        for one in self.psd_constraints:
            if one.slopes.shape[1] > 1:
                groups.setdefault((one.slopes.shape[1], _columns(one).tobytes()), []).append(one)
        return tuple(_Matrices.of(_columns(same[0]), same) for same in groups.values())

    @cached_property
    def _numbers(self) -> tuple[Array, Array, Array]:
        """Rows (L, v) and slack (L) of numbers that must be positive, and their share in the sum (L)."""
        found = [one for one in self.psd_constraints if one.slopes.shape[1] == 1]
        if not found:
            return np.zeros((0, 0)), np.zeros(0), np.zeros(0)
        rows = np.concatenate([one.slopes[:, 0, 0] for one in found])
        slack = np.concatenate([one.constant[:, 0, 0] for one in found])
        return rows, slack, np.concatenate([np.full(len(one.slopes), 1.0 / len(one.slopes)) for one in found])

    @cached_property
    def _linear_gradient(self) -> Array:
        """Gradient (v) of the part that is linear in x; (1), zero, without constraints."""
        return np.asarray(sum((one.linear_gradient for one in self.psd_constraints), np.zeros(1)))

    @cached_property
    def bound(self) -> NDArray[np.bool_]:
        """Which components of x (v) act on a matrix with a centre, which keeps them finite; (1), false, without any."""
        rows = [np.abs(one.slopes).sum(axis=(0, 1, 2)) for one in self.psd_constraints if one.centre is not None]
        return np.asarray(np.sum(rows, axis=0) > 0) if rows else np.zeros(1, dtype=bool)

    @property
    def degree(self) -> int:
        """Number of eigenvalues that must be positive: the distance from the optimum is ``weight`` times as large."""
        return sum(one.slopes.shape[0] * one.slopes.shape[1] for one in self.psd_constraints)

    def _roots(self, x: Array) -> tuple[Array, list[Array]] | None:
        """Return the numbers (L) and the Cholesky factors of the matrices at x, None outside the feasible set."""
        rows, slack, _ = self._numbers
        values = slack + rows @ x if len(rows) else slack
        if not (values > 0).all():
            return None
        try:
            return values, [one.root(x) for one in self._matrices]
        except np.linalg.LinAlgError:
            return None

    def inside(self, x: Array) -> bool:
        """Return whether all matrices are positive definite at x (v)."""
        return self._roots(x) is not None

    def value(self, x: Array, weight: float | None = None) -> float:
        """Return the barrier, with another weight if one is given, at x (v); infinite outside."""
        if (known := self._roots(x)) is None:
            return np.inf
        values, roots = known
        found = float((self._linear_gradient * x).sum() - self._numbers[2] @ np.log(values))
        for one, root in zip(self._matrices, roots, strict=True):
            found -= 2.0 * float(one.share @ np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1))
        return (self.weight if weight is None else weight) * found

    def slopes(self, x: Array, weight: float | None = None) -> tuple[Array, Array]:
        """Return gradient (v) and Hessian (v, v) at a feasible x; raises LinAlgError outside."""
        if (found := self._roots(x)) is None:
            raise np.linalg.LinAlgError("a constrained matrix is not positive definite.")
        (values, roots), (rows, _, share) = found, self._numbers
        gradient, hessian = self._linear_gradient + np.zeros(len(x)), np.zeros((len(x), len(x)))
        if len(rows):
            turned = rows / values[:, None]
            gradient -= share @ turned
            hessian += (turned * share[:, None]).T @ turned
        for one, root in zip(self._matrices, roots, strict=True):
            inverse = np.linalg.inv(root)[:, None]
            turned = inverse @ one.slopes @ np.swapaxes(inverse, -1, -2)  # (K, c, s, s), symmetric
            gradient[one.columns] -= one.share @ np.trace(turned, axis1=-2, axis2=-1)
            turned *= np.sqrt(one.share)[:, None, None, None]
            flat = np.swapaxes(turned, 0, 1).reshape(len(one.columns), -1)
            hessian[np.ix_(one.columns, one.columns)] += flat @ flat.T
        weight = self.weight if weight is None else weight
        return weight * gradient, weight * hessian

    def along(self, origin: Array, directions: Array) -> Barrier:
        """Return the barrier at origin (v) + directions (v, w) y as one on y (w)."""
        return replace(self, psd_constraints=tuple(one.along(origin, directions) for one in self.psd_constraints))

    def minimum(self, H: Array, g: Array, accuracy: float) -> Array:
        """Return the x (v) that minimises x' H x / 2 - g' x plus the barrier, from a feasible x = 0.

        ``H`` may be singular where the barrier is strictly convex. For long steps the barrier's weight is decreased in
        stages. ``accuracy`` is that of the minimum.
        """
        x, weight = np.zeros(len(g)), self.weight
        step, fall = Penalised(H, g, ((self, weight),)).newton(x)
        if not self.inside(step):
            weight = max(weight, 0.1 * fall / max(len(self.psd_constraints), 1))
        while True:
            enough = 2 * max(accuracy, 0.1 * (weight - self.weight))
            x, _ = Penalised(H, g, ((self, weight),)).minimised(x, enough)
            if weight <= self.weight:
                return x
            weight = max(0.1 * weight, self.weight)


@dataclass(frozen=True, eq=False)
class Penalised:
    """The function x' H x / 2 - g' x plus ``barriers``, each with its weight."""

    H: Array
    g: Array
    barriers: tuple[tuple[Barrier, float], ...]

    def newton(self, x: Array) -> tuple[Array, float]:
        """Return Newton's step (v) from x, and twice the predicted decrease."""
        pull, stiff = self.g - self.H @ x, self.H
        for one, weight in self.barriers:
            push, bend = one.slopes(x, weight)
            pull, stiff = pull - push, stiff + bend
        step = _solved(stiff, pull)
        return step, float(pull @ step)

    def minimised(self, x: Array, enough: float, steps: int = INNER) -> tuple[Array, float]:
        """Take Newton's steps from x until the predicted decrease is below ``enough``; return x and twice that."""
        fall = np.inf
        for _ in range(steps):
            step, fall = self.newton(x)
            length = self._length(x, step, fall)
            x = x + length * step
            if fall < enough or not length:
                break
        return x, fall

    def _length(self, x: Array, step: Array, fall: float) -> float:
        """Return the step length by backtracking, 0 where rounding prevents a decrease."""
        here, slope, bend = self._barred(x), float((self.H @ x - self.g) @ step), float(step @ self.H @ step)
        length = 1.0
        while length > SHORTEST:
            change = length * slope + 0.5 * length**2 * bend
            if self._barred(x + length * step) - here + change <= -0.1 * length * fall:
                return length
            length *= 0.6
        return 0.0

    def _barred(self, x: Array) -> float:
        return sum(one.value(x, weight) for one, weight in self.barriers)


def _solved(H: Array, g: Array) -> Array:
    """Return H^-1 g, zero in directions in which H is only rounding."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-200))
    scaled = H * np.outer(scale, scale)
    try:
        return np.asarray(scale * cho_solve(cho_factor(scaled, check_finite=False), g * scale, check_finite=False))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(scaled)
        kept = values > 1e-14 * values[-1]
        return np.asarray(scale * (vectors[:, kept] @ ((vectors[:, kept].T @ (g * scale)) / values[kept])))
