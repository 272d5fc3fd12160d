"""Ten parameters of a payload as a body: made physically consistent, and as mass, centre and tensor with errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.estimators.constraints import BodyConstraint, Constraints
from dynident.estimators.constraints.cone import minimise
from dynident.models import to_physical

__all__ = ["Component", "PhysicalBody", "consistent", "physical"]

Array = NDArray[np.float64]
LENGTH, LIGHTEST = 0.1, 0.05  # m, kg: the size of a payload, for the scale of its pseudo-inertia
MARGIN = 1e-6  # least eigenvalue of the scaled pseudo-inertia
STEP = 1e-6


class Component(StrEnum):
    """A component of a body: mass, centre of mass, inertia about it."""

    MASS = "mass"
    X = "x"
    Y = "y"
    Z = "z"
    IXX = "Ixx"
    IXY = "Ixy"
    IYY = "Iyy"
    IXZ = "Ixz"
    IYZ = "Iyz"
    IZZ = "Izz"

    @property
    def unit(self) -> str:
        """Its unit in SI."""
        if self is Component.MASS:
            return "kg"
        return "m" if self in (Component.X, Component.Y, Component.Z) else "kg m^2"


@dataclass(frozen=True, eq=False)
class PhysicalBody:
    """Mass (kg), centre of mass (3) in m, and inertia (6) in kg m^2 about it: Ixx, Ixy, Iyy, Ixz, Iyz, Izz, all in one
    frame's axes; ``values`` (10), their ``std`` (10)."""

    values: Array
    std: Array

    __repr__ = brief

    @property
    def mass(self) -> float:
        """The mass in kg."""
        return float(self.values[0])

    @property
    def centre(self) -> Array:
        """The centre of mass (3) in m."""
        return np.asarray(self.values[1:4])

    @property
    def tensor(self) -> Array:
        """The inertia (3, 3) in kg m^2 about the centre of mass."""
        xx, xy, yy, xz, yz, zz = self.values[4:]
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def consistent(phi: Array, information: Array) -> Array:
    """Return the physically consistent parameters (10) nearest to phi (10) by their ``information`` (10, 10).

    A payload of no mass is consistent. Raises ModelError where the conic solver fails.
    """
    size = np.sqrt(max(float(phi[0]), LIGHTEST)) * np.array([LENGTH, LENGTH, LENGTH, 1.0])
    body = BodyConstraint("the payload", np.arange(10), size)
    if float(np.linalg.eigvalsh(body.scaled(phi))[0]) >= MARGIN:
        return phi
    scale = size[3] ** 2 * LENGTH ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    quadratic = information * np.outer(scale, scale)
    most = float(np.diag(quadratic).max())
    found = minimise(quadratic / most, np.zeros(10), Constraints(bodies=(body,), margin=MARGIN), phi, np.diag(scale))
    return np.asarray(phi + scale * found.point)


def physical(phi: Array) -> Array:
    """Return mass, centre and inertia about it (10) of the parameters (10), in the order of ``Component``."""
    mass, centre, tensor = to_physical(phi, "the payload")
    return np.array([mass, *centre, *tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def slopes(phi: Array, of: Callable[[Array], Array] = physical) -> Array:
    """Return the derivatives (10, 10) of ``physical`` by the parameters."""
    step = STEP * abs(phi[0])
    ends = [[of(phi + sign * step * one) for one in np.eye(10)] for sign in (1.0, -1.0)]
    return np.asarray((np.array(ends[0]) - np.array(ends[1])).T / (2 * step))
