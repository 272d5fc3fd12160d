"""The central path of a barrier, followed with primal and dual variables: ten to twenty steps, however near the edge.

The scaling of Nesterov and Todd and Mehrotra's predictor and corrector, as Vandenberghe (2010), "The CVXOPT linear and
quadratic cone program solvers", has them. The primal point stays feasible; the path ends at the barrier's weight.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from dynident.estimators.constraints.matrices import Matrices

__all__ = ["followed", "solver"]

Array = NDArray[np.float64]
STEPS = 100  # usually four to ten, some dozens from a bad start
LONGEST = 0.98  # share of the way to the boundary
LEAST = 0.1  # product of primal and dual, relative to the mean: away from the path near the boundary steps are short
SHORTER, SHORTEST = 0.8, 1e-3  # factor and least length of a step that would leave the path
CLOSE = 0.05  # of the products of primal and dual matrices, to the weight, and of the decrease that is left


def followed(H: Array, g: Array, matrices: Sequence[Matrices], x: Array, weights: tuple[float, float]) -> Array:
    """Return x (v) near the minimum of x' H x / 2 - g' x - weight * sum of log det, from a feasible x.

    ``weights`` are that at which the path begins, and that of the minimum. Where rounding ends the path early, the last
    point is returned.
    """
    weight, aim = weights
    found, known = [_Pair.central(one, x, weight) for one in matrices], x
    for _ in range(STEPS):
        try:
            known, (x, found, done) = x, _step(H, g, x, found, aim)
        except np.linalg.LinAlgError:
            break
        if done:
            break
    return known


@dataclass(frozen=True, eq=False)
class _Pair:
    """Constrained matrices (K, s, s) and their duals."""

    of: Matrices
    primal: Array
    dual: Array

    @classmethod
    def central(cls, of: Matrices, x: Array, weight: float) -> _Pair:
        """Return the pair at x (v) whose products are the weight."""
        primal = of.offset + of.change(x)
        return cls(of, primal, weight * of.share[:, None, None] * np.linalg.inv(primal))

    def scaled(self) -> _Scaled:
        """Return the scaling in which both are the same diagonal matrix."""
        L, R = np.linalg.cholesky(self.primal), np.linalg.cholesky(self.dual)
        U, values, _ = np.linalg.svd(np.swapaxes(R, 1, 2) @ L)
        inverse = np.swapaxes(R @ U, 1, 2) / np.sqrt(values)[:, :, None]
        return _Scaled(self, values, inverse, self.of.turned(inverse))


@dataclass(frozen=True, eq=False)
class _Scaled:
    """A pair in the scaling of Nesterov and Todd: primal ``inverse`` primal inverse' = dual = diag(``values`` (K, s)).

    ``slopes`` (K, c, s s) are the scaled ones.
    """

    pair: _Pair
    values: Array
    inverse: Array
    slopes: Array

    def change(self, dx: Array) -> Array:
        """Return the change (K, s, s) of the scaled primal."""
        found = dx[self.pair.of.columns][:, None] @ self.slopes
        return np.asarray(found.reshape(self.pair.primal.shape))

    def wanted(self, weight: float, second: Array | float = 0.0) -> Array:
        """Return the sum of both scaled changes that makes the product the weight, less what is of second order."""
        right = weight * self.pair.of.share[:, None, None] * np.eye(self.values.shape[1])
        right = right - self.values[:, :, None] ** 2 * np.eye(self.values.shape[1]) - second
        return np.asarray(2 * right / (self.values[:, :, None] + self.values[:, None, :]))

    def room(self, *changes: Array) -> float:
        """Return how often the changes (K, s, s) can be taken before one leaves the cone."""
        root = np.sqrt(self.values)
        scale = root[:, :, None] * root[:, None, :]
        least = min(float(np.linalg.eigvalsh(one / scale)[:, 0].min(initial=0.0)) for one in changes)
        return -1.0 / least if least < 0 else np.inf

    def products(self, primal: Array, dual: Array) -> Array:
        """Return the eigenvalues (K, s) of the products of both, after scaled changes (K, s, s), over their shares."""
        here = self.values[:, :, None] * np.eye(self.values.shape[1])
        root = np.linalg.cholesky(here + primal)
        found = np.linalg.eigvalsh(np.swapaxes(root, 1, 2) @ (here + dual) @ root)
        return np.asarray(found / self.pair.of.share[:, None])

    def moved(self, x: Array, change: Array) -> _Pair:
        """Return the pair at x (v), the change of the dual given scaled, in which no digit of it is lost."""
        of, inverse = self.pair.of, self.inverse
        dual = self.values[:, :, None] * np.eye(self.values.shape[1]) + change
        return _Pair(of, of.offset + of.change(x), np.swapaxes(inverse, 1, 2) @ dual @ inverse)


@dataclass(frozen=True, eq=False)
class _Direction:
    """A change of ``x`` (v), the scaled changes of each pair, and how often it can be taken."""

    x: Array
    primal: list[Array]
    dual: list[Array]
    room: float


def _step(H: Array, g: Array, x: Array, found: Sequence[_Pair], aim: float) -> tuple[Array, list[_Pair], bool]:
    """Return x and the pairs after one step, and whether they were close to the end of the path before."""
    scaled = [one.scaled() for one in found]
    stiff, pull = H.copy(), g - H @ x
    for one in scaled:
        one.pair.of.add_hessian(stiff, one.slopes)
        one.pair.of.add_gradient(pull, one.slopes, one.values[:, :, None] * np.eye(one.values.shape[1]))
    solve = solver(stiff)

    def direction(wanted: Sequence[Array]) -> _Direction:
        right = pull.copy()
        for one, both in zip(scaled, wanted, strict=True):
            one.pair.of.add_gradient(right, one.slopes, both)
        dx = solve(right)
        primal = [one.change(dx) for one in scaled]
        dual = [both - change for both, change in zip(wanted, primal, strict=True)]
        room = min(one.room(*pair) for one, *pair in zip(scaled, primal, dual, strict=True))
        return _Direction(dx, primal, dual, room)

    now = np.concatenate([(one.values**2 / one.pair.of.share[:, None]).ravel() for one in scaled])
    first = direction([one.wanted(aim) for one in scaled])
    done = float(np.abs(now / aim - 1).max()) < CLOSE and float(first.x @ stiff @ first.x) < CLOSE * aim
    target = max(aim, float(now.mean()) * (1 - min(1.0, first.room)))
    second = [(a @ b + b @ a) / 2 for a, b in zip(first.primal, first.dual, strict=True)]
    step = direction([one.wanted(target, both) for one, both in zip(scaled, second, strict=True)])
    length = min(1.0, LONGEST * step.room)
    while length > SHORTEST and not _near(scaled, step, length, float(now.mean())):
        length *= SHORTER
    x = x + length * step.x
    return x, [one.moved(x, length * by) for one, by in zip(scaled, step.dual, strict=True)], done


def _near(scaled: Sequence[_Scaled], step: _Direction, length: float, mean: float) -> bool:
    """Return whether a step stays near the path: no product of primal and dual is far below the others."""
    pairs = zip(scaled, step.primal, step.dual, strict=True)
    there = np.concatenate([one.products(length * a, length * b).ravel() for one, a, b in pairs])
    return bool(there.min() > LEAST * min(mean, there.mean()))


def solver(H: Array) -> Callable[[Array], Array]:
    """Return what multiplies by H^-1, zero in directions in which H is only rounding."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-200))
    scaled = H * np.outer(scale, scale)
    try:
        factor = cho_factor(scaled, check_finite=False)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(scaled)
        kept = values > 1e-14 * values[-1]
        half = vectors[:, kept] / np.sqrt(values[kept])
        return lambda g: np.asarray(scale * (half @ (half.T @ (g * scale))))
    return lambda g: np.asarray(scale * cho_solve(factor, g * scale, check_finite=False))
