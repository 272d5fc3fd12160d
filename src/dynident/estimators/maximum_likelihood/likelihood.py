"""The likelihood of eq. (7): its cost, its equations, and the points of a search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.constraints import Barrier
from dynident.estimators.maximum_likelihood.arrow import Arrow
from dynident.estimators.maximum_likelihood.columns import Columns
from dynident.estimators.maximum_likelihood.elimination import Elimination
from dynident.estimators.maximum_likelihood.equations import Equations, equations
from dynident.estimators.maximum_likelihood.segment import Segment, Sigma, State
from dynident.models import Model

__all__ = ["Likelihood", "Moves", "Point", "carried"]

Array = NDArray[np.float64]
Moves = Sequence[tuple[Array, Array]]  # of C and W, by segment
IDLE = 1e-6  # fall of the cost for a change by its own size, or by 1, below which a parameter has no effect


@dataclass(frozen=True, eq=False)
class Point:
    """The current point of the search."""

    states: tuple[State, ...]
    theta: Array
    cost: float


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The likelihood to maximise: a model on the segments of its logs, with their noise, and a barrier.

    theta moves along orthonormal ``directions`` (p, v) only: what neither data nor prior determine stays.
    """

    model: Model
    segments: tuple[Segment, ...]
    sigma: Sigma
    barrier: Barrier
    directions: Array
    columns: Columns

    def open_directions(self, information: Array, theta: Array, fixed: int | None) -> Array:
        """Return the directions (p, w) along which the information (p, p) or a prior moves all but the fixed one."""
        ways = self.directions
        effect = (ways * (information @ ways)).sum(axis=0) * np.maximum((theta @ ways) ** 2, 1.0)
        moves = (effect > IDLE) | (self.barrier.bound & (ways != 0).T).any(axis=1)
        return np.asarray(ways[:, moves if fixed is None else moves & (ways[fixed] == 0)])

    def cost(self, states: Sequence[State], theta: Array) -> float:
        """Return half the weighted squares plus the barrier; infinite outside the feasible set."""
        barrier = self.barrier.value(theta)
        if np.isinf(barrier):
            return barrier
        pairs = zip(self.segments, states, strict=True)
        return barrier + sum(one.cost(self.model, state, theta, self.sigma) for one, state in pairs)

    def equations(self, states: Sequence[State], theta: Array, *, mixed_hessian: bool) -> list[Equations]:
        """Return the normal equations of each segment."""
        pairs = zip(self.segments, states, strict=True)
        return [
            equations(one, self.model, x, theta, self.sigma, mixed_hessian=mixed_hessian, columns=self.columns)
            for one, x in pairs
        ]

    def linearised(
        self, states: Sequence[State], theta: Array, before: Sequence[Equations], *, mixed_hessian: bool
    ) -> list[Equations]:
        """Return the equations about states and theta; with the second derivatives of those before, if any."""
        found = self.equations(states, theta, mixed_hessian=mixed_hessian and not before)
        if not before:
            return found
        return [one.with_mixed_hessian(old.mixed_hessian) for one, old in zip(found, before, strict=True)]

    def trajectory_step(self, states: Sequence[State], theta: Array) -> tuple[tuple[Array, Array], ...]:
        """Return the step of Gauss and Newton of each C and W at this theta, for which no regressor is needed."""
        moves, none = [], Columns.none(len(theta))
        for one, state in zip(self.segments, states, strict=True):
            found = equations(one, self.model, state, theta, self.sigma, mixed_hessian=False, columns=none)
            moves.append(Elimination.of(found, Arrow(found.band, found.side), 0).step(np.zeros(0)))
        return tuple(moves)

    def point(self, states: tuple[State, ...], theta: Array) -> Point | None:
        """Return a point with its cost; None outside the feasible set."""
        cost = self.cost(states, theta)
        return Point(states, theta, cost) if np.isfinite(cost) else None


def carried(segments: Sequence[Segment], states: Sequence[State], moves: Moves, size: float = 1.0) -> tuple[State, ...]:
    """Return the states after ``size`` times their steps."""
    found = zip(segments, states, moves, strict=True)
    return tuple(one.moved(state, size * dC, size * dW) for one, state, (dC, dW) in found)
