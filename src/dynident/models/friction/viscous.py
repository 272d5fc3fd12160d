"""Viscous friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.models.equation import Equation
from dynident.models.friction.per_joint import PerJoint
from dynident.models.term import Joint

__all__ = ["Viscous"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Viscous(PerJoint):
    """Viscous friction, tau_j = Fv_j dq_j, in N m s/rad or N s/m (mu of the article's eqs. 39 and 40).

    It acts on the joints named in ``on`` (default: all of ``joints``). ``names``, ``expressions`` (meanings) and
    ``values`` (nominal), one for each joint in ``on``, replace the defaults, Fv_<joint> for the name. Raises ModelError
    for an unknown joint, or where the numbers of entries differ.

    >>> import dynident as dy
    >>> friction = dy.Viscous((dy.Joint("shoulder"), dy.Joint("rail", "prismatic")))
    >>> [(one.name, one.unit) for one in friction.parameters]
    [('Fv_shoulder', 'N m s/rad'), ('Fv_rail', 'N s/m')]
    """

    symbol = "Fv"
    role = "viscous"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return "viscous friction: torque per dq"

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return "N m s/rad" if joint.kind == "revolute" else "N s/m"

    def law(self, joint: Joint) -> Equation:  # noqa: ARG002
        """Return the torque at a joint as an equation."""
        return Equation("F_v * dq", ("F_v",))

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return dq

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        return np.ones_like(dq)
