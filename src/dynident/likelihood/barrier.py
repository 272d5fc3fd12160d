"""What physics demands of the parameters, as a barrier: matrices, linear in theta, that must stay positive definite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.inertia import to_pseudo
from dynident.log import Log
from dynident.model import Model
from dynident.terms.term import INERTIAL

__all__ = ["Barrier", "Demand", "demands"]

Array = NDArray[np.float64]
SIGNED = ("viscous", "coulomb", "rotor")
POSES = 16  # configurations of the recordings at which the mass matrix must be positive definite


@dataclass(frozen=True, eq=False)
class Demand:
    """Matrices (K, s, s) = ``slopes`` (K, s, s, p) theta that must be positive definite.

    ``centre`` (K, s, s), where given, is what they are drawn to: the cost is then the log-det divergence from it, which
    also keeps a body finite that the data leave free.
    """

    slopes: Array
    centre: Array | None = None


@dataclass(frozen=True, eq=False)
class Barrier:
    """``weight`` times the sum of -log det, or of log-det divergences, of the demanded matrices (mean over the K)."""

    demands: tuple[Demand, ...] = ()
    weight: float = 1e-3

    def inside(self, theta: Array) -> bool:
        """Return whether all matrices are positive definite at theta (p)."""
        return all(float(np.linalg.eigvalsh(one.slopes @ theta)[..., 0].min()) > 0 for one in self.demands)

    def terms(self, theta: Array) -> tuple[float, Array, Array]:
        """Return value, gradient (p) and Hessian (p, p) at a theta inside."""
        p = len(theta)
        value, gradient, hessian = 0.0, np.zeros(p), np.zeros((p, p))
        for one in self.demands:
            K, at = len(one.slopes), one.slopes @ theta
            turned = np.linalg.solve(at[:, None], np.moveaxis(one.slopes, -1, 1))  # (K, p, s, s)
            value -= float(np.linalg.slogdet(at)[1].sum()) / K
            gradient -= np.trace(turned, axis1=-2, axis2=-1).sum(axis=0) / K
            flat = turned.transpose(1, 0, 2, 3).reshape(p, -1)
            hessian += flat @ turned.transpose(1, 0, 3, 2).reshape(p, -1).T / K
            if one.centre is not None:
                pull = np.linalg.solve(one.centre[:, None], np.moveaxis(one.slopes, -1, 1))
                slope = np.trace(pull, axis1=-2, axis2=-1).sum(axis=0) / K
                value += float(slope @ theta)
                gradient += slope
        return self.weight * value, self.weight * gradient, self.weight * hessian


def demands(model: Model, logs: Sequence[Log], start: Array) -> tuple[Demand, ...]:
    """Return what physics demands: bodies with a mass distribution, friction and rotors that are not negative.

    Bodies are drawn to those of ``start`` (p). A model without bodies must have a positive definite mass matrix at
    configurations of the logs, where it has one at all.
    """
    found, p = [], len(model.parameters)
    place = {(x.body, x.role): k for k, x in enumerate(model.parameters) if x.body}
    unit = np.eye(p)
    for body in dict.fromkeys(x.body for x in model.parameters if x.role in INERTIAL):
        columns = [place[body, role] for role in INERTIAL if (body, role) in place]
        if len(columns) == len(INERTIAL):
            slopes = np.moveaxis(to_pseudo(unit[columns].T), 0, -1)[None]
            found.append(Demand(slopes, slopes @ start))
    if not found:
        q = np.concatenate([log.q[:: max(len(log) * len(logs) // POSES, 1)] for log in logs])
        slopes = np.stack([model.mass_matrix(q, one) for one in unit], axis=-1)
        if (np.abs(slopes).sum(axis=(0, 2, 3)) > 0).all():
            found.append(Demand(slopes))
    for k, parameter in enumerate(model.parameters):
        if parameter.role in SIGNED:
            found.append(Demand(unit[k].reshape(1, 1, 1, p)))
    return tuple(found)
