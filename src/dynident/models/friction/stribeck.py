"""The Stribeck effect: the excess of dry friction at low speed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dynident.models.equation import Equation
from dynident.models.friction.dry_friction import WIDTH, FrictionBySpeed
from dynident.models.friction.joint_term import Constant, Speed
from dynident.models.term import Joint

__all__ = ["Stribeck"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stribeck(FrictionBySpeed):
    """Stribeck friction, tau_j = Fs_j exp(-(dq_j / velocity)^2) sign(dq_j), in N m or N.

    It is what friction at low speed exceeds Coulomb friction by, with exponent 2 (Armstrong-Helouvry et al. 1994,
    Automatica 30(7)). ``velocity`` and ``width`` (of tanh in place of the sign) are in rad/s or m/s, of all
    joints or by joint; other fields as in ``Viscous``.

    >>> import dynident as dy
    >>> joints = dy.Joint("shoulder"), dy.Joint("elbow")
    >>> friction = dy.models.Stribeck(joints, velocity={"shoulder": 0.05, "elbow": 0.2})
    >>> friction.parameters[1].expression
    'Stribeck friction: torque per exp(-(dq/0.2)^2) sign(dq)'
    """

    constants: ClassVar[Mapping[str, Constant]] = {"width": WIDTH, "velocity": Constant()}
    velocity: Speed = field(kw_only=True)
    symbol = "Fs"
    role = "coulomb"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return f"Stribeck friction: torque per exp(-(dq/{self.velocity:g})^2) {self.sign_words()}"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        sign, width = self.sign_law(joint, "w_s")
        speed = "v_s", self.constant("velocity", joint.name), f"{joint.unit}/s"
        return Equation(f"F_s * exp(-(dq / v_s)**2) * {sign}", ("F_s",), (speed, *width))

    def magnitude(self, speed: Array) -> Array:
        """Return the torque per unit of the parameter and of the sign."""
        return np.asarray(np.exp(-((speed / self.by_column("velocity")) ** 2)))

    def steepness(self, speed: Array) -> Array:
        """Return the derivative of ``magnitude`` by the speed."""
        return np.asarray(-2 * speed / self.by_column("velocity") ** 2 * self.magnitude(speed))

    def formula(self) -> str:
        """Return ``shape`` as NumPy source."""
        return f"np.exp(-((dq / {self.source('velocity')}) ** 2)) * {self.sign_source()}"
