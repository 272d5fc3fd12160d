"""The base of friction with the sign of the velocity, which may be smooth."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from dynident.models.friction.joint_term import Constant
from dynident.models.friction.per_joint import PerJoint
from dynident.models.term import Joint
from dynident.smoothers import BY_JOINT

__all__ = ["WIDTH", "DryFriction", "FrictionBySpeed", "Width"]

Array = NDArray[np.float64]
Width = Annotated[Annotated[float, Ge(0)] | Mapping[str, Annotated[float, Ge(0)]], BY_JOINT]
WIDTH = Constant("a velocity of 0 or more, in rad/s or m/s", low=1e-300, high=1e300, zero=True)


@dataclass(frozen=True)
class DryFriction(PerJoint):
    """Base of friction against the motion: tau_j = theta_j sign(dq_j).

    ``width`` > 0 (rad/s, m/s), of all joints or by joint, makes the sign tanh(dq / width), which a simulation needs.
    With width 0 the sign is discontinuous, sign(0) = 0, and its derivative is 0, also at the jump.
    """

    constants: ClassVar[Mapping[str, Constant]] = {"width": WIDTH}
    width: Width = 0.0

    @property
    def sharp(self) -> NDArray[np.bool_]:
        """At which joints in ``on`` the torque jumps, or rises infinitely fast, where the velocity changes its sign."""
        return np.asarray(self.by_column("width") == 0)

    @property
    def discontinuous(self) -> bool:
        """Whether it does so at any joint."""
        return bool(self.sharp.any())

    def with_smooth_sign(self, width: Array) -> tuple[Self]:
        """Return the friction with tanh(dq / width) in place of a sharp sign, each joint with its own width (n)."""
        widths = np.where(self.sharp, np.asarray(width)[self._columns], self.by_column("width"))
        return (replace(self, width=dict(zip(self.acts_on, widths.tolist(), strict=True))),)

    def sign(self, dq: Array) -> Array:
        """Return the sign of the velocity (N, p), or its smooth form."""
        width = self.by_column("width")
        if not width.any():
            return np.sign(dq)
        smooth = np.tanh(dq / np.where(width > 0, width, 1.0))
        return smooth if width.all() else np.where(width > 0, smooth, np.sign(dq))

    def rise(self, dq: Array) -> Array:
        """Return the derivative of ``sign``."""
        width = self.by_column("width")
        if not width.any():
            return np.zeros_like(dq)
        slope = (1 - np.tanh(dq / np.where(width > 0, width, 1.0)) ** 2) / np.where(width > 0, width, np.inf)
        return np.asarray(slope)

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return self.sign(dq)

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        return self.rise(dq)

    def sign_source(self) -> str:
        """Return ``sign`` as NumPy source."""
        width = self.by_column("width")
        if not width.any():
            return "np.sign(dq)"
        if width.all():
            return f"np.tanh(dq / {self.source('width')})"
        divisor = np.where(width > 0, width, 1.0).tolist()
        return f"np.where({(width > 0).tolist()!r}, np.tanh(dq / np.array({divisor!r})), np.sign(dq))"

    def sign_law(self, joint: Joint, symbol: str) -> tuple[str, tuple[tuple[str, float, str], ...]]:
        """Return the sign at a joint as a factor of an equation, and the width as its constant ``symbol``."""
        width = float(self.constant("width", joint.name))
        return (f"tanh(dq / {symbol})", ((symbol, width, f"{joint.unit}/s"),)) if width else ("sign(dq)", ())

    def sign_words(self) -> str:
        """Return the sign as a part of ``meaning``, of a term on one joint."""
        width = self.constant("width", self.acts_on[0])
        return f"tanh(dq/{width:g})" if width else "sign(dq)"


@dataclass(frozen=True)
class FrictionBySpeed(DryFriction):
    """Base of friction against the motion that depends on the speed: tau_j = theta_j m(abs(dq_j)) sign(dq_j)."""

    @abstractmethod
    def magnitude(self, speed: Array) -> Array:
        """Return m for speeds (N, p), which are not negative."""

    @abstractmethod
    def steepness(self, speed: Array) -> Array:
        """Return the derivative of ``magnitude``."""

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return self.magnitude(np.abs(dq)) * self.sign(dq)

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        speed = np.abs(dq)
        return self.magnitude(speed) * self.rise(dq) + self.steepness(speed) * np.sign(dq) * self.sign(dq)
