"""The base of friction with the sign of the velocity, which may be smooth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Self

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.models.friction.joint_term import Constant, PerJoint, Speed
from dynident.models.term import Joint
from dynident.motion.smoothers import BY_JOINT
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array

Width = Annotated[Annotated[float, Ge(0)] | Mapping[str, Annotated[float, Ge(0)]], BY_JOINT]
WIDTH = Constant("a velocity of 0 or more, in rad/s or m/s", low=1e-300, high=1e300, zero=True)


@dataclass(frozen=True)
class DryFriction(PerJoint):
    """Base of friction against the motion, whose law holds ``sign(dq, width)``.

    ``width`` > 0 (rad/s, m/s), of all joints or by joint, makes the sign tanh(dq / width), which a simulation needs.
    With width 0 the sign is discontinuous, sign(0) = 0, and its derivative is 0, also at the jump.
    """

    sign: ClassVar[str] = "sign(dq, width)"
    constants: ClassVar[Mapping[str, Constant]] = {"width": WIDTH}
    width: Width = 0.0

    @property
    def sharp(self) -> NDArray[np.bool_]:
        """At which joints in ``on`` the torque jumps, or rises infinitely fast, where the velocity changes its sign."""
        return np.asarray(self.by_column("width") == 0)

    @property
    def discontinuous(self) -> bool:
        """Whether this is so at any joint in ``on``."""
        return bool(self.sharp.any())

    def with_smooth_sign(self, width: Array) -> tuple[Self]:
        """Return the friction with tanh(dq / width) in place of a sharp sign, each joint with its own width (n)."""
        # joints whose sign is smooth already keep their width
        widths = np.where(self.sharp, np.asarray(width)[self._columns], self.by_column("width"))
        return (replace(self, width=dict(zip(self.acts_on, widths.tolist(), strict=True))),)

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source."""
        width, sign = self.by_column("width"), "sign(dq)"
        if width.all():
            sign = f"tanh(dq / {self.source('width')})"
        elif width.any():  # a divisor of one where the width is zero: there the smooth sign is not used
            divisor = np.where(width > 0, width, 1.0).tolist()
            sign = f"where({(width > 0).tolist()!r}, tanh(dq / np.array({divisor!r})), sign(dq))"
        return self._source_of(self.law.replace(self.sign, sign))

    def law_at(self, joint: Joint) -> str:
        """Return the law at a joint, with the sign as it is there."""
        return self.law.replace(self.sign, "tanh(dq / width)" if self.constant("width", joint.name) else "sign(dq)")

    def _format(self, text: str, joint: Joint) -> str:
        width = self.constant("width", joint.name)
        return super()._format(text.replace("{sign}", f"tanh(dq/{width:g})" if width else "sign(dq)"), joint)


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

    title: ClassVar[str] = "Coulomb friction"

    sign: ClassVar[str] = "sign(dq, width, dead_band)"
    constants: ClassVar[Mapping[str, Constant]] = {
        "width": replace(WIDTH, letter="w_c"),
        "dead_band": replace(WIDTH, letter="d_c"),
    }
    dead_band: Width = 0.0
    symbol = "Fc"
    role = "coulomb"
    law = sign
    words = "Coulomb friction: torque per {sign}"

    def __post_init__(self) -> None:
        super().__post_init__()
        for width, band in map(self.rule, self.acts_on):
            # both would change the sign near zero, in contradicting ways
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
        _, band = self.rule(self.acts_on[0])
        return super().meaning() + (f", 0 within abs(dq) <= {band:g}" if band else "")

    def law_at(self, joint: Joint) -> str:
        """Return the law at a joint, with the sign as it is there."""
        return "sign(dq, dead_band)" if self.rule(joint.name)[1] else super().law_at(joint)

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source."""
        band, sign = self.by_column("dead_band"), super().formula()
        return f"np.where(np.abs(dq) > {self.source('dead_band')}, {sign}, 0.0)" if band.any() else sign


@dataclass(frozen=True)
class WideCoulomb(PerJoint):
    """Friction that is reached at a higher speed than ``Coulomb``, tau_j = Fw_j tanh(dq_j / width), in N m or N.

    Beside ``Coulomb``, friction rises from Fc to Fc + Fw over a ``width`` (rad/s, m/s; of all joints or by joint), as
    lubricated contacts do that viscous friction alone does not describe. Other fields as in ``Viscous``.

    >>> import dynident as dy
    >>> dy.models.friction.WideCoulomb((dy.Joint("elbow"),), width=0.5).parameters[0].expression
    'Coulomb friction of a wide sign: torque per tanh(dq/0.5)'
    """

    title: ClassVar[str] = "Coulomb friction of a wide sign"

    constants: ClassVar[Mapping[str, Constant]] = {"width": Constant(letter="w_w")}
    width: Speed = field(kw_only=True)
    symbol = "Fw"
    role = "coulomb"
    law = "tanh(dq / width)"
    words = "Coulomb friction of a wide sign: torque per tanh(dq/{width:g})"


@dataclass(frozen=True)
class AsymmetricCoulomb(PerJoint):
    """Half of what Coulomb friction differs by between the directions, tau_j = Fca_j tanh(dq_j / width)^2, in N m or N.

    Beside ``Coulomb``, friction is Fc + Fca in the positive direction, Fc - Fca in the negative one
    (Armstrong-Helouvry et al. 1994, Automatica 30(7)). With a ``width`` (rad/s, m/s; of all joints or by joint) of zero
    it would be ``Offset``, from which only slow samples tell it apart. Other fields as in ``Viscous``.

    >>> import dynident as dy
    >>> dy.models.friction.AsymmetricCoulomb((dy.Joint("elbow"),), width=0.02).parameters[0].expression
    'asymmetric Coulomb friction: torque per tanh(dq/0.02)^2'
    """

    title: ClassVar[str] = "half of what Coulomb friction differs by between the directions"

    constants: ClassVar[Mapping[str, Constant]] = {"width": Constant(letter="w_a")}
    width: Speed = field(kw_only=True)
    symbol = "Fca"
    law = "tanh(dq / width)**2"
    words = "asymmetric Coulomb friction: torque per tanh(dq/{width:g})^2"


@dataclass(frozen=True)
class AsymmetricViscous(PerJoint):
    """Half of what viscous friction differs by between the directions, tau_j = Fva_j abs(dq_j), in N m s/rad or N s/m.

    Beside ``Viscous``, friction is (Fv + Fva) dq in the positive direction, (Fv - Fva) dq in the negative one. Its
    slope is 0 at rest, where it jumps. Fields as in ``Viscous``.

    >>> import dynident as dy
    >>> dy.models.friction.AsymmetricViscous((dy.Joint("elbow"),)).parameters[0].name
    'Fva_elbow'
    """

    title: ClassVar[str] = "half of what viscous friction differs by between the directions"

    symbol = "Fva"
    law = "abs(dq)"
    words = "asymmetric viscous friction: torque per abs(dq)"
    unit_text = "{effort} s/{unit}"


@dataclass(frozen=True)
class Stribeck(DryFriction):
    """Stribeck friction, tau_j = Fs_j exp(-(dq_j / velocity)^2) sign(dq_j), in N m or N.

    It is what friction at low speed exceeds Coulomb friction by, with exponent 2 (Armstrong-Helouvry et al. 1994,
    Automatica 30(7)). ``velocity`` and ``width`` (of tanh in place of the sign) are in rad/s or m/s, of all
    joints or by joint; other fields as in ``Viscous``.

    >>> import dynident as dy
    >>> joints = dy.Joint("shoulder"), dy.Joint("elbow")
    >>> friction = dy.models.friction.Stribeck(joints, velocity={"shoulder": 0.05, "elbow": 0.2})
    >>> friction.parameters[1].expression
    'Stribeck friction: torque per exp(-(dq/0.2)^2) sign(dq)'
    """

    title: ClassVar[str] = "Stribeck friction"

    constants: ClassVar[Mapping[str, Constant]] = {
        "width": replace(WIDTH, letter="w_s"),
        "velocity": Constant(letter="v_s"),
    }
    velocity: Speed = field(kw_only=True)
    symbol = "Fs"
    role = "coulomb"
    law = "exp(-(dq / velocity)**2) * sign(dq, width)"
    words = "Stribeck friction: torque per exp(-(dq/{velocity:g})^2) {sign}"


MAX_EXPONENT = 3.0
Exponent = Annotated[float, Gt(0), Le(MAX_EXPONENT)]


@dataclass(frozen=True)
class Power(DryFriction):
    """Friction with a power of the speed, tau_j = Fp_j abs(dq_j)^exponent sign(dq_j), in N m (s/rad)^exponent.

    Below 1, it rises less and less with the speed, as that of lubricants does (Waiboer et al. 2005, "Velocity
    dependence of joint friction in robotic manipulators with gear transmissions"); 2 is drag. ``exponent`` (above 0, at
    most 3) and ``width`` (of tanh in place of the sign; rad/s, m/s) are those of all joints or by joint; other fields
    as in ``Viscous``.

    >>> import dynident as dy
    >>> friction = dy.models.friction.Power((dy.Joint("elbow"), dy.Joint("rail", "prismatic")), exponent=0.5)
    >>> [(parameter.name, parameter.unit) for parameter in friction.parameters]
    [('Fp_elbow', 'N m (s/rad)^0.5'), ('Fp_rail', 'N (s/m)^0.5')]
    """

    title: ClassVar[str] = "friction with a power of the speed"

    constants: ClassVar[Mapping[str, Constant]] = {
        "width": replace(WIDTH, letter="w_p"),
        "exponent": Constant("an exponent above 0, at most 3", high=MAX_EXPONENT, letter="p", unit="1"),
    }
    exponent: Annotated[Exponent | Mapping[str, Exponent], BY_JOINT] = field(kw_only=True)
    symbol = "Fp"
    role = "viscous"
    law = "abs(dq)**exponent * sign(dq, width)"
    words = "friction: torque per abs(dq)^{exponent:g} {sign}"
    unit_text = "{effort} (s/{unit})^{exponent:g}"

    @property
    def sharp(self) -> NDArray[np.bool_]:
        """At which joints in ``on`` the torque rises infinitely fast where the velocity changes its sign."""
        return np.asarray((self.by_column("width") == 0) & (self.by_column("exponent") < 1))
