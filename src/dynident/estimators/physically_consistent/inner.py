"""The first program by a barrier method, where the conic solver fails: from well inside to the edge, along the path.

The conic solver works from outside, and its rounding grows with the distance to go; this way, each point is feasible.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, ModelError
from dynident.estimators.constraints import Barrier, Constraints, Limit
from dynident.estimators.constraints.cone import minimise

__all__ = ["descended"]

Array = NDArray[np.float64]
INSIDE = (1e4, 1e3, 1e2, 10.0, 3.0)  # times the margin, at the point from which the path begins
FAR = 10.0  # usual sizes, of a parameter at that point
NARROWER = 1e-3  # limits there, in usual sizes
WEIGHT = 1e-3  # of the barrier in the end, in squared standard errors: each limit costs as much at most


def descended(
    quadratic: Array, origin: Array, directions: Array, constraints: Constraints, scale: Array
) -> Array | None:
    """Return the x (v) that minimises x' quadratic x / 2 with theta = origin (p) + directions (p, v) x constrained.

    ``scale`` (p) is the usual size of the parameters. None where no point inside the constraints is found.
    """
    start = _inside(constraints, origin, scale)
    if start is None:
        return None
    length = np.linalg.norm(directions / scale[:, None], axis=0)
    x = np.linalg.lstsq(directions / length / scale[:, None], (start - origin) / scale, rcond=1e-14)[0] / length
    turned = directions @ (along := held(constraints, directions))
    here = origin + directions @ x
    matrices = (*constraints.psd_constraints(here, turned), *constraints.numbers(here, turned))
    barrier = Barrier(matrices, WEIGHT)
    if not barrier.inside(np.zeros(turned.shape[1])):
        return None
    H, g = along.T @ quadratic @ along, -along.T @ (quadratic @ x)
    return np.asarray(x + along @ barrier.minimum(H, g, 0.1 * WEIGHT))


def held(constraints: Constraints, directions: Array) -> Array:
    """Return the coordinates (v, r) of directions (p, v) along which no equality changes."""
    rows = [limit.rows[limit.lower == limit.upper] @ directions for limit in constraints.limits]
    fixed = np.concatenate([np.zeros((1, directions.shape[1])), *rows])
    _, s, Vt = np.linalg.svd(fixed)
    return np.asarray(Vt[int((s > 1e-9).sum()) :].T)


def _inside(constraints: Constraints, origin: Array, scale: Array) -> Array | None:
    """Return a point (p) inside the constraints, near bodies of their usual size."""
    aim, p = np.clip(origin, -FAR * scale, FAR * scale), len(scale)
    for body in constraints.bodies:
        aim[body.columns] = 0.0
        aim[body.columns[[0, 4, 6, 9]]] = body.size[3] ** 2 * np.append(1.0, 2.0 * (body.size[:3] / body.size[3]) ** 2)
    limits = tuple(map(_within, constraints.limits))
    for times in INSIDE:
        tighter = replace(constraints, limits=limits, margin=min(times * constraints.margin, 0.1))
        try:
            found = minimise(np.eye(p), np.zeros(p), tighter, aim, np.diag(scale))
        except (ConfigError, ModelError):
            continue
        theta = np.asarray(aim + scale * found.point)
        matrices = (*constraints.psd_constraints(theta, np.eye(p)), *constraints.numbers(theta, np.eye(p)))
        if Barrier(matrices).inside(np.zeros(p)):
            return theta
    return None


def _within(limit: Limit) -> Limit:
    """Return limits that are a little narrower."""
    by = np.minimum(NARROWER, 0.25 * (limit.upper - limit.lower))
    return replace(limit, lower=limit.lower + by, upper=limit.upper - by)
