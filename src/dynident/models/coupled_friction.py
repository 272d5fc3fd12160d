"""Friction of a motor coupled to several joints, by any law that single joints have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, choices
from dynident.models.equation import Equation
from dynident.models.friction import AsymmetricViscous, Coulomb, JointTerm, Power, Stribeck
from dynident.models.motor import CoupledMotor
from dynident.models.term import HasSign, Joint, Parameter, Partials

__all__ = ["CoupledFriction"]

Array = NDArray[np.float64]
Law = Literal["coulomb", "stribeck", "power", "asymmetric_viscous"]
LAWS: Mapping[str, type[JointTerm]] = {
    "coulomb": Coulomb,
    "stribeck": Stribeck,
    "power": Power,
    "asymmetric_viscous": AsymmetricViscous,
}


@dataclass(frozen=True)
class CoupledFriction:
    """Friction of a motor at phi = sum c_k q_k: a torque f(dphi) of the motor, c_k f on each of its joints.

    ``law`` names f by its kind, with the constants of its shape in ``settings``, in units of dphi (rad/s, or m/s where
    all of the joints slide). ``coefficients`` and ``name`` of the motor are as in ``CoupledMotor``, whose friction this
    adds to; parameters are named after law and motor. Raises ModelError for an unknown law or constant, and as
    ``CoupledMotor`` and the law do.

    >>> import dynident as dy
    >>> wrist = tuple(map(dy.Joint, ("joint_5", "joint_6")))
    >>> both = {"joint_5": 1, "joint_6": 1}
    >>> more = dy.models.CoupledFriction(wrist, both, name="m6", law="power", settings={"exponent": 0.3})
    >>> [one.name for one in more.parameters]
    ['power_m6']
    """

    joints: tuple[Joint, ...] = field(repr=False)
    coefficients: Mapping[str, float] | tuple[tuple[str, float], ...]
    name: str
    law: Law
    settings: Mapping[str, float] | tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        motor = CoupledMotor(self.joints, self.coefficients, self.name)  # checks them
        object.__setattr__(self, "joints", motor.joints)
        object.__setattr__(self, "coefficients", motor.coefficients)
        given = self.settings
        pairs = given.items() if isinstance(given, Mapping) else given
        object.__setattr__(self, "settings", tuple((str(name), value) for name, value in pairs))
        where = f"Friction of the coupling {self.name!r}"
        if self.law not in LAWS:
            raise ModelError(f"{where}: no law {self.law!r}; {choices(str(self.law), get_args(Law))}")
        known = tuple(LAWS[self.law].constants)
        for name, _ in self._constants:
            if name not in known:
                words = choices(name, known) if known else "leave it out."
                raise ModelError(f"{where}: {self.law} has no constant {name!r}; {words}")
        wanted = [one.name for one in fields(LAWS[self.law]) if one.name in known and one.default is MISSING]
        if missing := [name for name in wanted if name not in dict(self._constants)]:
            raise ModelError(f"{where}: {self.law} needs its constant {missing[0]!r} in `settings`.")
        _ = self._friction

    @property
    def acts_on(self) -> tuple[str, ...]:
        """The joints that are coupled."""
        return tuple(name for name, _ in self._pairs)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of the law."""
        (own,) = self._friction.parameters
        motion = " + ".join(f"{c:g} {name}" for name, c in self._pairs).replace("+ -", "- ")
        return (replace(own, name=f"{self.law}_{self.name}", expression=f"{own.expression} of the motor at {motion}"),)

    @property
    def equations(self) -> tuple[Equation, ...]:
        """The equation of the motor."""
        name = self.parameters[0].name
        laws = self._friction.equations
        return tuple(replace(law, parameters=(name,), on=self._pairs, motor=self.name) for law in laws)

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, 1): at the joints that are coupled."""
        return np.asarray(self._vector[:, None] != 0)

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y, shape (N, n, 1), for q, dq, ddq (N, n) in rad or m and seconds."""
        return np.asarray(self._vector[:, None] * self._friction.regressor(*self._motor(q, dq, ddq)))

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        """Return the derivatives of Y theta by q, dq and ddq, each (N, n, n)."""
        slopes = self._friction.partials(*self._motor(q, dq, ddq), theta)
        outer = np.outer(self._vector, self._vector)
        return Partials(*(outer * getattr(slopes, wrt) for wrt in ("q", "dq", "ddq")))

    @property
    def discontinuous(self) -> bool:
        """Whether the torque jumps with the sign of the motor's velocity."""
        return isinstance(self._friction, HasSign) and self._friction.discontinuous

    def with_smooth_sign(self, width: Array) -> tuple[CoupledFriction]:
        """Return the friction with the ``width`` of its sign propagated from those (n) of its joints."""
        if not self.discontinuous:
            return (self,)
        own = float(np.linalg.norm(self._vector * width))
        return (replace(self, settings=dict(self._constants) | {"width": own}),)

    def numpy_source(self, name: str, theta: Array) -> str:
        """Return the text of a function of q, dq and ddq that gives Y theta."""
        return (
            f"def {name}(q, dq, ddq):\n"
            f"    c = np.array({self._vector.tolist()!r})[:, None]\n"
            f"    q, dq, ddq = q @ c, dq @ c, ddq @ c\n"
            f"    return {theta.tolist()[0]!r} * ({self._friction.formula()}) @ c.T\n"
        )

    @property
    def _pairs(self) -> tuple[tuple[str, float], ...]:
        return tuple(self.coefficients.items()) if isinstance(self.coefficients, Mapping) else self.coefficients

    @property
    def _constants(self) -> tuple[tuple[str, float], ...]:
        return tuple(self.settings.items()) if isinstance(self.settings, Mapping) else self.settings

    @cached_property
    def _vector(self) -> Array:
        """The coefficients (n) of the joints, zero for those that are not coupled."""
        return np.array([dict(self._pairs).get(joint.name, 0.0) for joint in self.joints])

    @cached_property
    def _friction(self) -> JointTerm:
        """The law as a term of an arm whose only joint is the motor."""
        kinds = {joint.name: joint.kind for joint in self.joints}
        slides = all(kinds[name] == "prismatic" for name, _ in self._pairs)
        motor = Joint(self.name, "prismatic" if slides else "revolute")
        return LAWS[self.law]((motor,), **dict(self._constants))  # type: ignore[arg-type]

    def _motor(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
        c = self._vector[:, None]
        return q @ c, dq @ c, ddq @ c
