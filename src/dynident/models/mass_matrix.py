"""The mass matrix of a model: solved for accelerations, and checked to be positive definite."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, brief

if TYPE_CHECKING:
    from dynident.models.model import Model

__all__ = ["MassMatrixCheck", "accelerations", "checked_mass"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MassMatrixCheck:
    """The ``smallest`` eigenvalue of the mass matrix over some configurations, and the configuration ``q`` (n) of it.

    ``positive`` is True where it exceeds the rounding error of the largest eigenvalue. With both revolute and prismatic
    joints only the sign of the eigenvalue is meaningful; its size depends on the units.
    """

    smallest: float
    q: Array
    positive: bool

    __repr__ = brief


def accelerations(model: Model, q: Array, tau: Array, theta: Array, mass: Array, bias: Array) -> Array:
    """Return mass^-1 (tau - bias), shape (N, n); ModelError where the mass matrix (N, n, n) is singular."""
    try:
        ddq = np.linalg.solve(mass, (tau - bias)[..., None])[..., 0]
    except np.linalg.LinAlgError:
        _singular(model, q, mass, theta)
    # a solution this large comes from a mass matrix that is singular to working precision
    reach = 10 * np.finfo(float).eps * np.abs(mass).max(axis=(1, 2)) * np.abs(ddq).max(axis=1)
    if (reach > np.abs(tau).max(axis=1) + np.abs(bias).max(axis=1)).any():
        _singular(model, q, mass, theta)
    return np.asarray(ddq, dtype=np.float64)


def _singular(model: Model, q: Array, mass: Array, theta: Array) -> NoReturn:
    i = int(np.argmin(np.abs(np.linalg.eigvalsh(mass)).min(axis=1)))
    raise ModelError(
        f"{model.name}: the mass matrix is singular at q = {q[i].tolist()} for theta = "
        f"{(theta[i] if theta.ndim == 2 else theta).tolist()}; every joint needs an inertia."
    )


def checked_mass(model: Model, q: Array, mass: Array) -> MassMatrixCheck:
    """Return the smallest eigenvalue of mass matrices (N, n, n) at q (N, n), N at least 1."""
    if not len(q):
        raise ModelError(f"{model.name}: the mass matrix cannot be checked at 0 configurations; give some rows of q.")
    eigenvalues = np.linalg.eigvalsh(mass)
    i = int(np.argmin(eigenvalues[:, 0]))
    rounding = np.finfo(float).eps * len(model.joints) * np.abs(eigenvalues[i]).max()
    smallest = float(eigenvalues[i, 0])
    return MassMatrixCheck(smallest, q[i].copy(), smallest > rounding)
