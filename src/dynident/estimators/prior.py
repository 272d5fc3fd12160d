"""The second program of a consistent fit: towards a prior, along the directions only that the data leave free.

A point that meets the constraints is known from the first program, so that a barrier method with Newton steps in the
few free directions cannot fail to return one: where a body lies on the boundary of what is possible, the room left is
too thin for a general conic solver. Boyd and Vandenberghe (2004), "Convex optimization", chapter 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.constraints import Body, Constraints
from dynident.estimators.staged import Information

__all__ = ["nearest", "settle"]

Array = NDArray[np.float64]
TINY = 1e-9  # room given to limits that the first program left none
GAP = 1e-8  # distance from the optimum, relative to the objective, at which the barrier has done its work
STEPS = 60  # Newton steps for one weight of the barrier; about ten are needed


def nearest(known: Information, theta: Array, prior: Array) -> Array:
    """Return theta (p) moved along the free directions to the least Euclidean distance from the prior (p)."""
    aim = (prior - theta) / known.scale
    return np.asarray(theta + known.free @ ((known.free / known.scale[:, None]).T @ aim))


def settle(
    known: Information, constraints: Constraints, theta: Array, prior: Array, entropic: Sequence[Body]
) -> tuple[Array, float]:
    """Return theta (p) moved along the free directions towards the prior (p), and the duality gap left.

    The distance is tr(P0^-1 P) - log det(P0^-1 P) of the pseudo-inertia P from the prior's P0 for the bodies in
    ``entropic``: Lee, Wensing and Park (2020), "Geometric robot dynamic identification". It is half the squared
    Euclidean one, in units of the parameters' scale, for all other parameters.
    """
    directions = known.free @ _held(constraints, known.free)
    if not directions.shape[1]:
        return theta, 0.0
    eased = constraints.eased(0.5)
    if not entropic and eased.violation(close := nearest(known, theta, prior)) <= 0:
        return close, 0.0
    program = _program(known, eased, theta, directions, prior, entropic)
    x, gap = _descend(program)
    return theta + directions @ x, gap


@dataclass(frozen=True, eq=False)
class _Program:
    """Minimise x' quadratic x / 2 + linear' x - sum log det of the first matrices, inside all matrices and lines.

    Matrices are ``offset`` (b, 4, 4) + x times ``slopes`` (b, v, 4, 4), the first ``entropic`` of them in the
    objective; lines are ``room`` (k) + ``rows`` (k, v) x > 0.
    """

    quadratic: Array
    linear: Array
    slopes: Array
    offset: Array
    entropic: int
    rows: Array
    room: Array

    def weights(self, barrier: float) -> Array:
        """Return the weight of each matrix."""
        return np.where(np.arange(len(self.offset)) < self.entropic, 1.0, barrier)

    def factors(self, x: Array) -> Array | None:
        """Return the Cholesky factors (b, 4, 4), or None where x lies outside."""
        try:
            found = np.linalg.cholesky(self.offset + np.tensordot(x, self.slopes, axes=(0, 1)))
        except np.linalg.LinAlgError:
            return None
        return None if (self.room + self.rows @ x <= 0).any() else np.asarray(found)

    def value(self, x: Array, barrier: float) -> float:
        """Return the objective with its barrier, infinite outside."""
        factors = self.factors(x)
        if factors is None:
            return np.inf
        logs = 2.0 * np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
        own = 0.5 * x @ self.quadratic @ x + self.linear @ x - self.weights(barrier) @ logs
        return float(own - barrier * np.log(self.room + self.rows @ x).sum())

    def newton(self, x: Array, barrier: float) -> tuple[Array, float]:
        """Return the Newton step (v) from x, and the squared decrement."""
        factors = self.factors(x)
        inverse = np.linalg.inv(factors)  # type: ignore[arg-type]  # x lies inside
        twice = np.einsum("bij,bkl->bjlik", inverse, inverse).reshape(-1, 16, 16)
        turned = self.slopes.reshape(*self.slopes.shape[:2], 16) @ twice
        weighted = turned * self.weights(barrier)[:, None, None]
        lines = self.rows / (self.room + self.rows @ x)[:, None]
        slope = self.quadratic @ x + self.linear - barrier * lines.sum(axis=0)
        slope = slope - weighted[:, :, ::5].sum(axis=(0, 2))
        flat = turned.swapaxes(0, 1).reshape(len(x), -1)
        bend = self.quadratic + weighted.swapaxes(0, 1).reshape(len(x), -1) @ flat.T + barrier * lines.T @ lines
        size = np.sqrt(np.diag(bend))
        values, vectors = np.linalg.eigh(bend / np.outer(size, size))
        # rounding may not turn the step uphill
        step = -vectors @ ((vectors.T @ (slope / size)) / np.maximum(values, 1e-14 * values[-1])) / size
        return step, float(-slope @ step)


def _descend(program: _Program) -> tuple[Array, float]:
    """Follow the central path from x = 0; return x and a bound of its distance from the optimum in the objective."""
    x, barrier = np.zeros(len(program.linear)), 1.0
    demands = 4 * (len(program.offset) - program.entropic) + len(program.room)
    while True:
        for _ in range(STEPS):
            step, decrement = program.newton(x, barrier)
            length = _search(program, x, step, barrier, decrement)
            x = x + length * step
            if decrement < 1e-2 * barrier or not length:
                break
        gap = (barrier * demands + decrement) / max(1.0, abs(program.value(x, 0.0)))
        if gap < GAP or barrier < 1e-2 * GAP:
            return x, gap
        barrier *= 0.1


def _search(program: _Program, x: Array, step: Array, barrier: float, decrement: float) -> float:
    """Return how far to go along the step: backtracking; 0 where rounding leaves nothing to gain."""
    here, length = program.value(x, barrier), 1.0
    while length > 1e-4:
        if program.value(x + length * step, barrier) <= here - 0.1 * length * decrement:
            return length
        length *= 0.5
    return 0.0


def _held(constraints: Constraints, free: Array) -> Array:
    """Return the coordinates (q, r) of the free directions (p, q) that change no equality."""
    rows = [limit.rows[limit.lower == limit.upper] @ free for limit in constraints.limits]
    fixed = np.concatenate([np.zeros((1, free.shape[1])), *rows])
    _, s, Vt = np.linalg.svd(fixed)
    return np.asarray(Vt[int((s > 1e-9).sum()) :].T)


def _program(
    known: Information,
    constraints: Constraints,
    theta: Array,
    directions: Array,
    prior: Array,
    entropic: Sequence[Body],
) -> _Program:
    others = np.ones(len(theta), dtype=bool)
    others[[k for body in entropic for k in body.columns]] = False
    slope, away = directions / known.scale[:, None] * others[:, None], others * (theta - prior) / known.scale
    quadratic, linear = slope.T @ slope, slope.T @ away
    for body in entropic:
        linear = linear + np.sum(body.scaled(directions) * np.linalg.inv(body.scaled(prior)), axis=(1, 2))
    moved = [body for body in constraints.bodies if np.abs(body.scaled(directions)).max(initial=0.0) > TINY]
    slopes = [body.scaled(directions) for body in (*entropic, *moved)]
    inner = [body.scaled(theta) for body in entropic]
    outer = [body.scaled(theta) - constraints.margin * np.eye(4) for body in moved]
    return _Program(
        quadratic,
        linear,
        np.array(slopes).reshape(-1, len(linear), 4, 4),
        np.array(inner + outer).reshape(-1, 4, 4),
        len(entropic),
        *_lines(constraints, theta, directions),
    )


def _lines(constraints: Constraints, theta: Array, directions: Array) -> tuple[Array, Array]:
    """Return the inequalities as rows (k, v) and their room (k) at theta, which is never less than TINY."""
    rows, room = [np.zeros((0, directions.shape[1]))], [np.zeros(0)]
    for limit in constraints.limits:
        slope, value = limit.rows @ directions, limit.rows @ theta
        for sign, left in ((1.0, value - limit.lower), (-1.0, limit.upper - value)):
            used = np.isfinite(left) & (limit.lower < limit.upper) & (np.abs(slope) > TINY).any(axis=1)
            rows.append(sign * slope[used])
            room.append(np.maximum(left[used], TINY))
    return np.concatenate(rows), np.concatenate(room)
