"""The second program of a consistent fit: towards a prior, only along the directions that the data do not determine.

The first program gives a feasible point, from which a barrier method with Newton steps in the few free directions
always returns a feasible point; a general conic solver may fail where a body lies on the boundary and the feasible set
is thin. Boyd and Vandenberghe (2004), "Convex optimization", chapter 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.constraints import Barrier, BodyConstraint, Constraints, Penalised
from dynident.estimators.physically_consistent.inner import held
from dynident.estimators.physically_consistent.staged import Information

__all__ = ["drawn", "move_to_prior", "nearest"]

Array = NDArray[np.float64]
TINY = 1e-9  # slack given to limits that are active after the first program
GAP = 1e-8  # distance from the optimum, relative to the objective, at which the barrier method stops
STEPS = 60  # Newton steps for one weight of the barrier; about ten are needed


def nearest(known: Information, theta: Array, prior: Array) -> Array:
    """Return theta (p) moved along the free directions to the smallest Euclidean distance from the prior (p)."""
    aim = (prior - theta) / known.scale
    return np.asarray(theta + known.free @ ((known.free / known.scale[:, None]).T @ aim))


def drawn(known: Information, prior: Array, strength: float) -> Information:
    """Return the information with a penalty on the distance from the prior (p, nan where there is none), in d alone.

    It is ``strength`` times the squared residual where a parameter is one usual size away from the prior; w, which the
    data do not determine, is where the distance is least. The base is the optimum, and |d|^2 the increase from it.
    """
    with_prior = ~np.isnan(prior)
    if not strength or not with_prior.any():
        return known
    shape = (1.0 / known.scale)[with_prior, None]
    free, _ = np.linalg.qr(known.free[with_prior] * shape) if known.free.shape[1] else (np.zeros((len(shape), 0)), None)
    A = known.informed[with_prior] * shape
    away = (prior - known.base)[with_prior] * shape[:, 0]
    A, away = A - free @ (free.T @ A), away - free @ (free.T @ away)
    share = strength * known.noise
    values, turn = np.linalg.eigh(np.eye(known.rank) + share * A.T @ A)
    half = turn / np.sqrt(values)
    d = half @ (half.T @ (share * A.T @ away))
    return replace(known, base=known.base + known.informed @ d, informed=known.informed @ half)


def move_to_prior(
    known: Information, constraints: Constraints, theta: Array, prior: Array, entropic: Sequence[BodyConstraint]
) -> tuple[Array, float]:
    """Return theta (p) moved along the free directions towards the prior (p), and the remaining duality gap.

    The distance is tr(P0^-1 P) - log det(P0^-1 P) of the pseudo-inertia P from the prior's P0 for the bodies in
    ``entropic``: Lee, Wensing and Park (2020), "Geometric robot dynamic identification". It is half the squared
    Euclidean one, in units of the parameters' scale, for all other parameters.
    """
    directions = known.free @ held(constraints, known.free)
    if not directions.shape[1]:
        return theta, 0.0
    relaxed = constraints.relaxed(0.5)
    if not entropic and relaxed.violation(close := nearest(known, theta, prior)) <= 0:
        return close, 0.0
    program = _program(known, relaxed, theta, directions, prior, entropic)
    x, gap = program.descended()
    return theta + directions @ x, gap


@dataclass(frozen=True, eq=False)
class _Program:
    """Minimise x' H x / 2 - g' x + ``kept`` at x (v), inside ``edge``."""

    H: Array
    g: Array
    kept: Barrier
    edge: Barrier

    def descended(self) -> tuple[Array, float]:
        """Follow the central path from x = 0; return x and a bound on the objective's distance from its optimum."""
        x = np.zeros(len(self.g))
        weight = max(1.0, self._with_edge(1.0).newton(x)[1])  # smaller beside the way to go, it takes too many steps
        while True:
            x, fall = self._with_edge(weight).minimised(x, 1e-2 * weight, STEPS)
            cost = float(0.5 * x @ self.H @ x - self.g @ x) + self.kept.value(x)
            gap = (weight * self.edge.degree + fall) / max(1.0, abs(cost))
            if gap < GAP or weight < 1e-2 * GAP:
                return x, gap
            weight *= 0.1

    def _with_edge(self, weight: float) -> Penalised:
        return Penalised(self.H, self.g, ((self.kept, 1.0), (self.edge, weight)))


def _program(
    known: Information,
    constraints: Constraints,
    theta: Array,
    directions: Array,
    prior: Array,
    entropic: Sequence[BodyConstraint],
) -> _Program:
    others = np.ones(len(theta), dtype=bool)
    others[[k for body in entropic for k in body.columns]] = False
    slope, away = directions / known.scale[:, None] * others[:, None], others * (theta - prior) / known.scale
    drawn = [replace(body.psd_constraint(len(theta)), centre=body.scaled(prior)[None]) for body in entropic]
    kept = tuple(one.along(theta, directions) for one in drawn)
    moved = [
        one for one in constraints.psd_constraints(theta, directions) if np.abs(one.slopes).max(initial=0.0) > TINY
    ]
    for one in constraints.numbers(theta, directions):
        if (np.abs(one.slopes) > TINY).any():
            moved.append(replace(one, offset=np.maximum(one.constant, TINY)))
    return _Program(slope.T @ slope, -slope.T @ away, Barrier(kept, 1.0), Barrier(tuple(moved)))
