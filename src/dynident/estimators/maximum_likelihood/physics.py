"""Physical constraints on the parameters of eq. (7), and what may move: bodies by a prior, all else by the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.constraints import Barrier, BodyConstraint, PsdConstraint, physics
from dynident.log import Log
from dynident.models import Model, to_pseudo
from dynident.regression import Rank

__all__ = ["movable", "psd_constraints"]

Array = NDArray[np.float64]
ROUND = 0.01  # least eigenvalue of a prior, relative to its diagonal
POSES = 16  # configurations of the recordings at which the mass matrix must be positive definite


def psd_constraints(model: Model, logs: Sequence[Log], start: Array) -> tuple[PsdConstraint, ...]:
    """Return the physical constraints on a model at the configurations of the logs.

    The prior of the bodies is nominal, or that of ``start`` (p).
    """
    poses = np.concatenate([log.q[:: max(len(log) * len(logs) // POSES, 1)] for log in logs])
    found = physics(model, poses)
    bodies, p = found.bodies, len(model.parameters)
    drawn = [replace(body.psd_constraint(p), centre=_centre(body, model, start)[None]) for body in bodies]
    return (*drawn, *found.matrices, *found.numbers(np.zeros(p), np.eye(p)))


def movable(barrier: Barrier, rank: Rank) -> tuple[Barrier, Array]:
    """Return the constraints on what may move, and the orthonormal directions (p, v) in which it may.

    What the data do not determine stays at the start, which may lie on a limit, unless a prior keeps it finite.
    """
    directions = rank.reached(barrier.bound)
    kept = tuple(one for one in barrier.psd_constraints if (one.slopes @ directions).any())
    return replace(barrier, psd_constraints=kept), directions


def _centre(body: BodyConstraint, model: Model, start: Array) -> Array:
    """Return the prior pseudo-inertia (4, 4) of a body: the nominal one, or else that of the start, regularised."""
    known = [model.parameters[k].value for k in body.columns]
    size = np.outer(body.size, body.size)
    if None not in known:
        nominal = to_pseudo(np.array(known, dtype=float))
        scale = np.sqrt(np.maximum(np.diag(nominal), 1e-300))
        if np.linalg.eigvalsh(nominal / np.outer(scale, scale))[0] > ROUND:
            return np.asarray(nominal / size)
    found = to_pseudo(start[body.columns])
    moments = np.abs(np.diag(found))
    return np.asarray((found + ROUND * np.diag(np.maximum(moments, 1e-3 * moments.max()))) / size)
