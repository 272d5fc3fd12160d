"""Coulomb friction, by the sign of the velocity or a smooth one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.models.equation import Equation
from dynident.models.friction.dry_friction import WIDTH, DryFriction, Width
from dynident.models.friction.joint_term import Constant, Speed
from dynident.models.friction.per_joint import PerJoint
from dynident.models.term import Joint

__all__ = ["Coulomb", "WideCoulomb"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Coulomb(DryFriction):
    """Coulomb friction, tau_j = Fc_j sign(dq_j), in N m or N; ``on``, ``names``, ... as in ``Viscous``.

    The sign can be changed in one of two ways, both in rad/s or m/s, of all joints or by joint: ``width`` > 0 makes it
    tanh(dq / width), which a simulation needs; ``dead_band`` > 0 makes it 0 for abs(dq) <= dead_band, which leaves
    uncertain signs out of a fit. With neither, sign(0) = 0. The discontinuous sign has derivative 0 in ``partials``,
    also at the jump. Raises ModelError where both are given for a joint or one is negative or not finite, and as
    ``Viscous`` does.

    >>> import dynident as dy
    >>> dy.Coulomb((dy.Joint("shoulder"), dy.Joint("elbow")), on=("elbow",), width=0.01)
    Coulomb(on=('elbow',), names=None, expressions=None, values=None, width=0.01, dead_band=0.0)
    """

    constants: ClassVar[Mapping[str, Constant]] = {"width": WIDTH, "dead_band": WIDTH}
    dead_band: Width = 0.0
    symbol = "Fc"
    role = "coulomb"

    def __post_init__(self) -> None:
        super().__post_init__()
        for width, band in map(self.rule, self.acts_on):
            if width and band:
                raise ModelError(f"Coulomb: width {width} and dead_band {band} exclude each other; set one to 0.")

    @property
    def sharp(self) -> NDArray[np.bool_]:
        """At which joints in ``on`` the torque jumps with the sign of the velocity: no width and no dead band."""
        return np.asarray((self.by_column("width") == 0) & (self.by_column("dead_band") == 0))

    def rule(self, joint: str) -> tuple[float, float]:
        """Return width and dead band of the sign at a joint."""
        return float(self.constant("width", joint)), float(self.constant("dead_band", joint))

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        _, dead = self.rule(self.acts_on[0])
        band = f", 0 within abs(dq) <= {dead:g}" if dead else ""
        return f"Coulomb friction: torque per {self.sign_words()}{band}"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        sign, width = self.sign_law(joint, "w_c")
        if band := self.rule(joint.name)[1]:
            sign, width = "sign(dq, d_c)", (("d_c", band, f"{joint.unit}/s"),)
        return Equation(f"F_c * {sign}", ("F_c",), width)

    def sign(self, dq: Array) -> Array:
        """Return the sign of the velocity (N, p), or its smooth form."""
        band = self.by_column("dead_band")
        sign = super().sign(dq)
        return np.where((band == 0) | (np.abs(dq) > band), sign, 0.0) if band.any() else sign

    def formula(self) -> str:
        """Return ``shape`` as NumPy source."""
        band, sign = self.by_column("dead_band"), self.sign_source()
        return f"np.where(np.abs(dq) > {self.source('dead_band')}, {sign}, 0.0)" if band.any() else sign


@dataclass(frozen=True)
class WideCoulomb(PerJoint):
    """Friction that is reached at a higher speed than ``Coulomb``, tau_j = Fw_j tanh(dq_j / width), in N m or N.

    Beside ``Coulomb``, friction rises from Fc to Fc + Fw over a ``width`` (rad/s, m/s; of all joints or by joint), as
    lubricated contacts do that viscous friction alone does not describe. Other fields as in ``Viscous``.

    >>> import dynident as dy
    >>> dy.models.WideCoulomb((dy.Joint("elbow"),), width=0.5).parameters[0].expression
    'Coulomb friction of a wide sign: torque per tanh(dq/0.5)'
    """

    constants: ClassVar[Mapping[str, Constant]] = {"width": Constant()}
    width: Speed = field(kw_only=True)
    symbol = "Fw"
    role = "coulomb"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return f"Coulomb friction of a wide sign: torque per tanh(dq/{self.width:g})"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        width = self.constant("width", joint.name)
        return Equation("F_w * tanh(dq / w_w)", ("F_w",), (("w_w", width, f"{joint.unit}/s"),))

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return np.asarray(np.tanh(dq / self.by_column("width")))

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        return np.asarray((1 - self.shape(dq) ** 2) / self.by_column("width"))

    def formula(self) -> str:
        """Return ``shape`` as NumPy source."""
        return f"np.tanh(dq / {self.source('width')})"
