"""What physics demands of the parameters of eq. (7), and what bodies are drawn to where the data leave them free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.constraints import BodyConstraint, PsdConstraint, physics
from dynident.log import Log
from dynident.models import Model, to_pseudo

__all__ = ["psd_constraints"]

Array = NDArray[np.float64]
ROUND = 0.01  # least eigenvalue of a body to draw others to, beside its diagonal
POSES = 16  # configurations of the recordings at which the mass matrix must be positive definite


def psd_constraints(model: Model, logs: Sequence[Log], start: Array) -> tuple[PsdConstraint, ...]:
    """Return what physics demands of a model at the configurations of the logs.

    Bodies are drawn to their nominal ones, or to those of ``start`` (p).
    """
    poses = np.concatenate([log.q[:: max(len(log) * len(logs) // POSES, 1)] for log in logs])
    found = physics(model, poses)
    bodies, p = found.bodies, len(model.parameters)
    drawn = [replace(body.psd_constraint(p), centre=_centre(body, model, start)[None]) for body in bodies]
    return (*drawn, *found.matrices, *found.numbers(np.zeros(p), np.eye(p)))


def _centre(body: BodyConstraint, model: Model, start: Array) -> Array:
    """Return the pseudo-inertia (4, 4) to draw a body to: the nominal one, or where that is none a start made round."""
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
