"""Friction with a power of the speed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt, Le
from numpy.typing import NDArray

from dynident.models.equation import Equation
from dynident.models.friction.dry_friction import WIDTH, FrictionBySpeed
from dynident.models.friction.joint_term import Constant
from dynident.models.term import Joint
from dynident.smoothers import BY_JOINT

__all__ = ["Power"]

Array = NDArray[np.float64]
HIGHEST = 3.0
Exponent = Annotated[float, Gt(0), Le(HIGHEST)]
STILL = 1e-50  # rad/s, m/s: below, the slope is that at this speed


@dataclass(frozen=True)
class Power(FrictionBySpeed):
    """Friction with a power of the speed, tau_j = Fp_j abs(dq_j)^exponent sign(dq_j), in N m (s/rad)^exponent.

    Below 1, it rises less and less with the speed, as that of lubricants does (Waiboer et al. 2005, "Velocity
    dependence of joint friction in robotic manipulators with gear transmissions"); 2 is drag. ``exponent`` (above 0, at
    most 3) and ``width`` (of tanh in place of the sign; rad/s, m/s) are those of all joints or by joint; other fields
    as in ``Viscous``.

    >>> import dynident as dy
    >>> friction = dy.models.Power((dy.Joint("elbow"), dy.Joint("rail", "prismatic")), exponent=0.5)
    >>> [(one.name, one.unit) for one in friction.parameters]
    [('Fp_elbow', 'N m (s/rad)^0.5'), ('Fp_rail', 'N (s/m)^0.5')]
    """

    constants: ClassVar[Mapping[str, Constant]] = {
        "width": WIDTH,
        "exponent": Constant("an exponent above 0, at most 3", high=HIGHEST),
    }
    exponent: Annotated[Exponent | Mapping[str, Exponent], BY_JOINT] = field(kw_only=True)
    symbol = "Fp"
    role = "viscous"

    @property
    def sharp(self) -> NDArray[np.bool_]:
        """At which joints in ``on`` the torque rises infinitely fast where the velocity changes its sign."""
        return np.asarray((self.by_column("width") == 0) & (self.by_column("exponent") < 1))

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return f"friction: torque per abs(dq)^{self.exponent:g} {self.sign_words()}"

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return f"{joint.effort} (s/{joint.unit})^{self.constant('exponent', joint.name):g}"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        sign, width = self.sign_law(joint, "w_p")
        exponent = "p", self.constant("exponent", joint.name), "1"
        return Equation(f"F_p * abs(dq)**p * {sign}", ("F_p",), (exponent, *width))

    def magnitude(self, speed: Array) -> Array:
        """Return the torque per unit of the parameter and of the sign."""
        return np.asarray(speed ** self.by_column("exponent"))

    def steepness(self, speed: Array) -> Array:
        """Return the derivative of ``magnitude`` by the speed."""
        exponent = self.by_column("exponent")
        return np.asarray(exponent * np.maximum(speed, STILL) ** (exponent - 1))

    def formula(self) -> str:
        """Return ``shape`` as NumPy source."""
        return f"np.abs(dq) ** {self.source('exponent')} * {self.sign_source()}"
