"""Friction that differs between the two directions of motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dynident.models.equation import Equation
from dynident.models.friction.joint_term import Constant, Speed
from dynident.models.friction.per_joint import PerJoint
from dynident.models.friction.viscous import Viscous
from dynident.models.term import Joint

__all__ = ["AsymmetricCoulomb", "AsymmetricViscous"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AsymmetricCoulomb(PerJoint):
    """Half of what Coulomb friction differs by between the directions, tau_j = Fca_j tanh(dq_j / width)^2, in N m or N.

    Beside ``Coulomb``, friction is Fc + Fca in the positive direction, Fc - Fca in the negative one
    (Armstrong-Helouvry et al. 1994, Automatica 30(7)). With a ``width`` (rad/s, m/s; of all joints or by joint) of zero
    it would be ``Offset``, from which only slow samples tell it apart. Other fields as in ``Viscous``.

    >>> import dynident as dy
    >>> dy.models.AsymmetricCoulomb((dy.Joint("elbow"),), width=0.02).parameters[0].expression
    'asymmetric Coulomb friction: torque per tanh(dq/0.02)^2'
    """

    constants: ClassVar[Mapping[str, Constant]] = {"width": Constant()}
    width: Speed = field(kw_only=True)
    symbol = "Fca"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return f"asymmetric Coulomb friction: torque per tanh(dq/{self.width:g})^2"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        width = self.constant("width", joint.name)
        return Equation("F_ca * tanh(dq / w_a)**2", ("F_ca",), (("w_a", width, f"{joint.unit}/s"),))

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return np.asarray(np.tanh(dq / self.by_column("width")) ** 2)

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        width = self.by_column("width")
        tanh = np.tanh(dq / width)
        return np.asarray(2 * tanh * (1 - tanh**2) / width)

    def formula(self) -> str:
        """Return ``shape`` as NumPy source."""
        return f"np.tanh(dq / {self.source('width')}) ** 2"


@dataclass(frozen=True)
class AsymmetricViscous(PerJoint):
    """Half of what viscous friction differs by between the directions, tau_j = Fva_j abs(dq_j), in N m s/rad or N s/m.

    Beside ``Viscous``, friction is (Fv + Fva) dq in the positive direction, (Fv - Fva) dq in the negative one. Its
    slope is 0 at rest, where it jumps. Fields as in ``Viscous``.

    >>> import dynident as dy
    >>> dy.models.AsymmetricViscous((dy.Joint("elbow"),)).parameters[0].name
    'Fva_elbow'
    """

    symbol = "Fva"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return "asymmetric viscous friction: torque per abs(dq)"

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return Viscous((joint,)).unit(joint)

    def law(self, joint: Joint) -> Equation:  # noqa: ARG002
        """Return the torque at a joint as an equation."""
        return Equation("F_va * abs(dq)", ("F_va",))

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return np.abs(dq)

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        return np.sign(dq)

    def formula(self) -> str:
        """Return ``shape`` as NumPy source."""
        return "np.abs(dq)"
