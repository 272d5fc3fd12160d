"""The base of friction with the sign of the velocity, which may be smooth."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Self

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.models.friction.joint_term import Constant, PerJoint, Speed, Viscous
from dynident.models.term import Equation, Joint
from dynident.motion.smoothers import BY_JOINT
from dynident.runtime import ModelError

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
        """Whether this is so at any joint in ``on``."""
        return bool(self.sharp.any())

    def with_smooth_sign(self, width: Array) -> tuple[Self]:
        """Return the friction with tanh(dq / width) in place of a sharp sign, each joint with its own width (n)."""
        # joints whose sign is smooth already keep their width
        widths = np.where(self.sharp, np.asarray(width)[self._columns], self.by_column("width"))
        return (replace(self, width=dict(zip(self.acts_on, widths.tolist(), strict=True))),)

    def sign(self, dq: Array) -> Array:
        """Return the sign of the velocity (N, p), or its smooth form."""
        width = self.by_column("width")
        if not width.any():
            return np.sign(dq)
        # a divisor of one where the width is zero: there the smooth sign is not used
        smooth = np.tanh(dq / np.where(width > 0, width, 1.0))
        return smooth if width.all() else np.where(width > 0, smooth, np.sign(dq))

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``sign``."""
        width = self.by_column("width")
        if not width.any():
            return np.zeros_like(dq)
        # widths of zero: a divisor of one avoids warnings, and an infinite one makes the slope zero
        slope = (1 - np.tanh(dq / np.where(width > 0, width, 1.0)) ** 2) / np.where(width > 0, width, np.inf)
        return np.asarray(slope)

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return self.sign(dq)

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
        # product rule, with sign(dq) as the derivative of the speed
        speed = np.abs(dq)
        return self.magnitude(speed) * super().slope(dq) + self.steepness(speed) * np.sign(dq) * self.sign(dq)


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

    constants: ClassVar[Mapping[str, Constant]] = {"width": WIDTH, "dead_band": WIDTH}
    dead_band: Width = 0.0
    symbol = "Fc"
    role = "coulomb"

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
    >>> dy.models.friction.WideCoulomb((dy.Joint("elbow"),), width=0.5).parameters[0].expression
    'Coulomb friction of a wide sign: torque per tanh(dq/0.5)'
    """

    title: ClassVar[str] = "Coulomb friction of a wide sign"

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
        # d/dx tanh(x)^2 = 2 tanh(x) (1 - tanh(x)^2)
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
    >>> dy.models.friction.AsymmetricViscous((dy.Joint("elbow"),)).parameters[0].name
    'Fva_elbow'
    """

    title: ClassVar[str] = "half of what viscous friction differs by between the directions"

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


@dataclass(frozen=True)
class Stribeck(FrictionBySpeed):
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


MAX_EXPONENT = 3.0
Exponent = Annotated[float, Gt(0), Le(MAX_EXPONENT)]
MIN_SPEED = 1e-50  # rad/s, m/s: below, the slope is that at this speed


@dataclass(frozen=True)
class Power(FrictionBySpeed):
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
        "width": WIDTH,
        "exponent": Constant("an exponent above 0, at most 3", high=MAX_EXPONENT),
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
        # below an exponent of 1 the slope is infinite at rest
        exponent = self.by_column("exponent")
        return np.asarray(exponent * np.maximum(speed, MIN_SPEED) ** (exponent - 1))

    def formula(self) -> str:
        """Return ``shape`` as NumPy source."""
        return f"np.abs(dq) ** {self.source('exponent')} * {self.sign_source()}"
