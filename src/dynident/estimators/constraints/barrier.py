"""A log-det barrier that keeps constrained matrices positive definite, and Newton's method inside it.

Boyd and Vandenberghe (2004), "Convex optimization", chapters 9 to 11.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.constraints.central_path import followed, solver
from dynident.estimators.constraints.constraints import PsdConstraint
from dynident.estimators.constraints.matrices import Matrices

__all__ = ["Barrier", "Penalised"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]
FEW = 6  # steps from a start, which is enough where it is close
INNER = 500  # steps at one weight of the barrier; usually a few, but many near the boundary for a thin body
LARGE = 0.1  # of the expected fall for each constraint: weight of the barrier at which the central path begins
SHORTEST = 1e-6  # share of a step below which the line search stops


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
    def matrices(self) -> tuple[Matrices, ...]:
        """The matrices, stacked where they are of one size and depend on as many components of x."""
        groups: dict[tuple[int, int], tuple[list[Index], list[PsdConstraint]]] = {}
        for one in self.psd_constraints:
            columns = _columns(one)
            same = groups.setdefault((one.slopes.shape[1], len(columns)), ([], []))
            same[0].append(columns)
            same[1].append(one)
        return tuple(Matrices.of(*same) for same in groups.values())

    @cached_property
    def linear_gradient(self) -> Array:
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

    def _roots(self, x: Array) -> list[Array] | None:
        """Return the Cholesky factors of the matrices at x, None outside the feasible set."""
        try:
            return [one.root(x) for one in self.matrices]
        except np.linalg.LinAlgError:
            return None

    def inside(self, x: Array) -> bool:
        """Return whether all matrices are positive definite at x (v)."""
        return self._roots(x) is not None

    def value(self, x: Array, weight: float | None = None) -> float:
        """Return the barrier, with another weight if one is given, at x (v); infinite outside."""
        if (roots := self._roots(x)) is None:
            return np.inf
        found = float((self.linear_gradient * x).sum())
        for one, root in zip(self.matrices, roots, strict=True):
            found -= 2.0 * float(one.share @ np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1))
        return (self.weight if weight is None else weight) * found

    def slopes(self, x: Array, weight: float | None = None) -> tuple[Array, Array]:
        """Return gradient (v) and Hessian (v, v) at a feasible x; raises LinAlgError outside."""
        if (roots := self._roots(x)) is None:
            raise np.linalg.LinAlgError("a constrained matrix is not positive definite.")
        gradient, hessian = self.linear_gradient + np.zeros(len(x)), np.zeros((len(x), len(x)))
        for one, root in zip(self.matrices, roots, strict=True):
            turned, share = one.turned(np.asarray(np.linalg.inv(root))), one.share[:, None, None]
            one.add_gradient(gradient, turned, -share * np.eye(root.shape[-1]))
            one.add_hessian(hessian, turned * np.sqrt(share))
        weight = self.weight if weight is None else weight
        return weight * gradient, weight * hessian

    def along(self, origin: Array, directions: Array) -> Barrier:
        """Return the barrier at origin (v) + directions (v, w) y as one on y (w)."""
        return replace(self, psd_constraints=tuple(one.along(origin, directions) for one in self.psd_constraints))

    def minimum(self, H: Array, g: Array, accuracy: float) -> Array:
        """Return the x (v) that minimises x' H x / 2 - g' x plus the barrier, from a feasible x = 0.

        ``H`` may be singular where the barrier is strictly convex. Where Newton's method does not end soon, the central
        path is followed first. ``accuracy`` is that of the minimum.
        """
        task, enough, start = Penalised(H, g, ((self, self.weight),)), 2 * accuracy, np.zeros(len(g))
        x, fall = task.minimised(start, enough, FEW)
        if fall < enough:
            return x
        first = max(self.weight, LARGE * task.newton(start)[1] / max(len(self.psd_constraints), 1))
        pull = g - self.weight * self.linear_gradient
        return task.minimised(followed(H, pull, self.matrices, start, (first, self.weight)), enough)[0]


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
        step = solver(stiff)(pull)
        return step, float(pull @ step)

    def minimised(self, x: Array, enough: float, steps: int = INNER) -> tuple[Array, float]:
        """Take Newton's steps from x until the predicted decrease is below ``enough``; return x and twice that."""
        fall, here = np.inf, self._barred(x)
        for _ in range(steps):
            step, fall = self.newton(x)
            length, here = self._length(x, step, fall, here)
            x = x + length * step
            if fall < enough or not length:
                break
        return x, fall

    def _length(self, x: Array, step: Array, fall: float, here: float) -> tuple[float, float]:
        """Return the step length by backtracking, 0 where rounding prevents a decrease, and the barriers there.

        ``here`` are the barriers at x.
        """
        slope, bend = float((self.H @ x - self.g) @ step), float(step @ self.H @ step)
        length = 1.0
        while length > SHORTEST:
            change, there = length * slope + 0.5 * length**2 * bend, self._barred(x + length * step)
            if there - here + change <= -0.1 * length * fall:
                return length, there
            length *= 0.6
        return 0.0, here

    def _barred(self, x: Array) -> float:
        return sum(one.value(x, weight) for one, weight in self.barriers)
