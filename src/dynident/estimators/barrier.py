"""A log-det barrier that keeps constrained matrices positive definite, and Newton's method inside it.

Boyd and Vandenberghe (2004), "Convex optimization", chapters 9 to 11.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from dynident.estimators.physical_constraints import PsdConstraint
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

Index = NDArray[np.intp]
MAX_DIRECT_STEPS = 6  # steps from a start, which is enough where it is close
MAX_NEWTON_STEPS = 500  # steps at one weight of the barrier; usually a few, but many near the boundary for a thin body
WEIGHT_FACTOR, CENTRED_DECREMENT = (
    0.1,
    1e-2,
)  # of the weight, from one point of the central path to the next; of it, the accuracy there
INITIAL_WEIGHT_SHARE = 0.1  # of the expected fall for each constraint: weight at which the central path begins
MIN_STEP_SHARE = 1e-6  # share of a step below which the line search stops


class Matrices(Noun):
    """Matrices of one size, each on as many components of x: ``columns`` (K, c), ``slopes`` (K, c, s, s).

    ``offset`` (K, s, s) are the matrices at zero, ``share`` (K) is the weight of each in the barrier.
    """

    columns: Index
    slopes: Array
    offset: Array
    share: Array

    @classmethod
    def of(cls, columns: Sequence[Index], constraints: Sequence[PsdConstraint]) -> Matrices:
        """Stack constraints on matrices of one size, each of which depends on its ``columns`` (c) of x."""
        pairs = list(zip(columns, constraints, strict=True))
        return cls(
            np.concatenate([np.tile(indices, (len(constraint.slopes), 1)) for indices, constraint in pairs]),
            np.concatenate([np.moveaxis(constraint.slopes[..., indices], -1, 1) for indices, constraint in pairs]),
            np.concatenate([constraint.constant for constraint in constraints]),
            np.concatenate([np.full(count, 1.0 / count) for count in (len(x.slopes) for x in constraints)]),
        )

    @cached_property
    def flat(self) -> Array:
        """The slopes as (K, c, s s)."""
        return self.slopes.reshape(*self.columns.shape, self.offset[0].size)

    def change(self, x: Array) -> Array:
        """Return the change (K, s, s) of the matrices by x (v)."""
        return np.asarray((x[self.columns][:, None] @ self.flat).reshape(self.offset.shape))

    def root(self, x: Array) -> Array:
        """Return the Cholesky factors (K, s, s) at x (v); raise LinAlgError outside the feasible set."""
        return np.asarray(np.linalg.cholesky(self.offset + self.change(x)))

    def transform_slopes(self, inverse: Array) -> Array:
        """Return the slopes between ``inverse`` (K, s, s) and its transpose, (K, c, s s)."""
        between = inverse[:, None] @ self.slopes @ np.swapaxes(inverse, -1, -2)[:, None]
        return np.asarray(between.reshape(self.flat.shape))

    def add_gradient(self, total: Array, slopes: Array, weights: Array) -> None:
        """Add the products of slopes (K, c, s s) with matrices ``weights`` (K, s, s) to ``total`` (v)."""
        products = (slopes @ weights.reshape(len(weights), -1, 1))[:, :, 0]
        # matrices may depend on the same component: bincount sums what indexing would overwrite
        total += np.bincount(self.columns.ravel(), products.ravel(), len(total))

    def add_hessian(self, total: Array, slopes: Array) -> None:
        """Add the products of the slopes (K, c, s s) with each other to ``total`` (v, v)."""
        v, products = len(total), slopes @ np.swapaxes(slopes, 1, 2)
        at = self.columns[:, :, None] * v + self.columns[:, None, :]
        total += np.bincount(at.ravel(), products.ravel(), v * v).reshape(v, v)


def solver(H: Array) -> Callable[[Array], Array]:
    """Return a function that multiplies by H^-1, with zero in directions in which H is only rounding."""
    # a unit diagonal makes the threshold for singular directions independent of units
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-200))
    unit_matrix = H * np.outer(scale, scale)
    try:
        factor = cho_factor(unit_matrix, check_finite=False)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(unit_matrix)
        significant = values > 1e-14 * values[-1]
        half = vectors[:, significant] / np.sqrt(values[significant])
        return lambda g: np.asarray(scale * (half @ (half.T @ (g * scale))))
    return lambda g: np.asarray(scale * cho_solve(factor, g * scale, check_finite=False))


class Barrier(Noun):
    """``weight`` times the sum of -log det, or of log-det divergences, of the matrices (mean over the K)."""

    psd_constraints: tuple[PsdConstraint, ...] = ()
    weight: float = 1e-3

    @cached_property
    def matrices(self) -> tuple[Matrices, ...]:
        """The matrices, stacked where they are of one size and depend on as many components of x."""
        groups: dict[tuple[int, int], tuple[list[Index], list[PsdConstraint]]] = {}
        for constraint in self.psd_constraints:
            columns = np.flatnonzero(np.abs(constraint.slopes).sum(axis=(0, 1, 2)))
            size = constraint.slopes.shape[-1]
            # constraints on most components share all columns, so that they can be stacked into one product
            columns = columns if 2 * len(columns) < size else np.arange(size)
            group = groups.setdefault((constraint.slopes.shape[1], len(columns)), ([], []))
            group[0].append(columns)
            group[1].append(constraint)
        return tuple(Matrices.of(*group) for group in groups.values())

    @cached_property
    def linear_gradient(self) -> Array:
        """Gradient (v) of the part that is linear in x; (1), zero, without constraints."""
        return np.asarray(sum((constraint.linear_gradient for constraint in self.psd_constraints), np.zeros(1)))

    @cached_property
    def centred_components(self) -> NDArray[np.bool_]:
        """The components of x (v) that a matrix with a centre keeps finite; (1), false, without any."""
        centred = [constraint for constraint in self.psd_constraints if constraint.centre is not None]
        rows = [np.abs(constraint.slopes).sum(axis=(0, 1, 2)) for constraint in centred]
        return np.asarray(np.sum(rows, axis=0) > 0) if rows else np.zeros(1, dtype=bool)

    @property
    def degree(self) -> int:
        """The number of eigenvalues kept positive; the distance from the optimum is ``weight`` times as large."""
        return sum(constraint.slopes.shape[0] * constraint.slopes.shape[1] for constraint in self.psd_constraints)

    def _cholesky_factors(self, x: Array) -> list[Array] | None:
        """Return the Cholesky factors of the matrices at x, None outside the feasible set."""
        try:
            return [stack.root(x) for stack in self.matrices]
        except np.linalg.LinAlgError:
            return None

    def is_inside(self, x: Array) -> bool:
        """Return whether all matrices are positive definite at x (v)."""
        return self._cholesky_factors(x) is not None

    def value(self, x: Array, weight: float | None = None) -> float:
        """Return the barrier, with another weight if one is given, at x (v); infinite outside."""
        if (roots := self._cholesky_factors(x)) is None:
            return np.inf
        total = float((self.linear_gradient * x).sum())
        for stack, root in zip(self.matrices, roots, strict=True):
            total -= 2.0 * float(stack.share @ np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1))
        return (self.weight if weight is None else weight) * total

    def derivatives(self, x: Array, weight: float | None = None) -> tuple[Array, Array]:
        """Return gradient (v) and Hessian (v, v) at a feasible x; raises LinAlgError outside."""
        if (roots := self._cholesky_factors(x)) is None:
            raise np.linalg.LinAlgError("a constrained matrix is not positive definite.")
        gradient, hessian = self.linear_gradient + np.zeros(len(x)), np.zeros((len(x), len(x)))
        for stack, root in zip(self.matrices, roots, strict=True):
            scaled_slopes, share = stack.transform_slopes(np.asarray(np.linalg.inv(root))), stack.share[:, None, None]
            stack.add_gradient(gradient, scaled_slopes, -share * np.eye(root.shape[-1]))
            stack.add_hessian(hessian, scaled_slopes * np.sqrt(share))
        weight = self.weight if weight is None else weight
        return weight * gradient, weight * hessian

    def restrict(self, origin: Array, directions: Array) -> Barrier:
        """Return the barrier as a function of y (w), where x = origin (v) + directions (v, w) y."""
        restricted = tuple(constraint.restrict(origin, directions) for constraint in self.psd_constraints)
        return replace(self, psd_constraints=restricted)

    def minimum(self, H: Array, g: Array, accuracy: float) -> Array:
        """Return the x (v) that minimises x' H x / 2 - g' x plus the barrier, starting from a feasible x = 0.

        ``H`` may be singular where the barrier is strictly convex. ``accuracy`` is that of the minimum. Where
        Newton's method does not converge in a few steps, the central path is followed first.
        """
        penalised, tolerance, start = PenalisedQuadratic(H, g, ((self, self.weight),)), 2 * accuracy, np.zeros(len(g))
        # a few plain Newton steps are enough from a good start and spare the central path
        x, decrement = penalised.minimise(start, tolerance, MAX_DIRECT_STEPS)
        if decrement < tolerance:
            return x
        # begin where each constraint costs a tenth of the expected decrease: the start is then well centred
        decrease, count = penalised.newton(start)[1], max(len(self.psd_constraints), 1)
        weight, x = max(self.weight, INITIAL_WEIGHT_SHARE * decrease / count), start
        while weight > self.weight:
            x, _ = PenalisedQuadratic(H, g, ((self, weight),)).minimise(x, CENTRED_DECREMENT * weight)
            weight *= WEIGHT_FACTOR
        return penalised.minimise(x, tolerance)[0]


class PenalisedQuadratic(Noun):
    """The function x' H x / 2 - g' x plus ``barriers``, each with its weight."""

    H: Array
    g: Array
    barriers: tuple[tuple[Barrier, float], ...]

    def newton(self, x: Array) -> tuple[Array, float]:
        """Return Newton's step (v) from x, and twice the predicted decrease."""
        descent, total_hessian = self.g - self.H @ x, self.H
        for barrier, weight in self.barriers:
            gradient, hessian = barrier.derivatives(x, weight)
            descent, total_hessian = descent - gradient, total_hessian + hessian
        step = solver(total_hessian)(descent)
        return step, float(descent @ step)

    def minimise(self, x: Array, tolerance: float, steps: int = MAX_NEWTON_STEPS) -> tuple[Array, float]:
        """Take Newton steps from x until the decrement, twice the predicted decrease, is below ``tolerance``."""
        decrement, barrier_value = np.inf, self._total_barrier(x)
        for _ in range(steps):
            step, decrement = self.newton(x)
            length, barrier_value = self._step_length(x, step, decrement, barrier_value)
            x = x + length * step
            if decrement < tolerance or not length:
                break
        return x, decrement

    def _step_length(self, x: Array, step: Array, decrement: float, barrier_value: float) -> tuple[float, float]:
        """Return the step length found by backtracking, 0 where rounding prevents a decrease, and the barriers there.

        ``barrier_value`` is the sum of the barriers at x.
        """
        slope, curvature = float((self.H @ x - self.g) @ step), float(step @ self.H @ step)
        length = 1.0
        while length > MIN_STEP_SHARE:
            # the quadratic is evaluated exactly along the step; only the barriers have to be computed anew
            change, next_value = length * slope + 0.5 * length**2 * curvature, self._total_barrier(x + length * step)
            if next_value - barrier_value + change <= -0.1 * length * decrement:
                return length, next_value
            length *= 0.6
        return 0.0, barrier_value

    def _total_barrier(self, x: Array) -> float:
        return sum(barrier.value(x, weight) for barrier, weight in self.barriers)
