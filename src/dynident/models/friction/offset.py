"""The constant torque of a joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.models.equation import Equation
from dynident.models.friction.per_joint import PerJoint
from dynident.models.term import Joint

__all__ = ["Offset"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Offset(PerJoint):
    """Constant torque of a joint, tau_j = offset_j, in N m or N; ``on``, ``names``, ... as in ``Viscous``.

    >>> import dynident as dy
    >>> dy.Offset((dy.Joint("elbow"),)).parameters[0].name
    'offset_elbow'
    """

    symbol = "offset"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return "constant torque"

    def law(self, joint: Joint) -> Equation:  # noqa: ARG002
        """Return the torque at a joint as an equation."""
        return Equation("tau_o", ("tau_o",))

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return np.ones_like(dq)

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        return np.zeros_like(dq)
