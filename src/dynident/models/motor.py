"""Motors: rotor inertia, and motors coupled to several joints."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property
from typing import ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dynident.models.friction import AsymmetricViscous, Coulomb, JointTerm, Offset, PerJoint, Power, Stribeck, Viscous
from dynident.models.term import Equation, Joint, Parameter, Partials, Term, check_joints
from dynident.runtime import ModelError, choices
from dynident.runtime.arrays import Array

MIN_COEFFICIENT, MAX_COEFFICIENT = 1e-9, 1e9  # of a joint in the angle of a motor, in size


@dataclass(frozen=True)
class RotorInertia(PerJoint):
    """Rotor inertia on the joint's side of the gear, tau_j = Ia_j ddq_j, in kg m^2 or kg; fields as in ``Viscous``.

    The gyroscopic torques of the rotor are neglected: they are small where the gear ratio is large (Siciliano et al.
    2009, "Robotics", sec. 7.3).

    >>> import dynident as dy
    >>> dy.RotorInertia((dy.Joint("elbow"),)).parameters[0].unit
    'kg m^2'
    """

    title: ClassVar[str] = "rotor inertia"

    symbol = "Ia"
    role = "rotor"
    law = "ddq"
    words = "rotor inertia: torque per ddq"

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return "kg m^2" if joint.kind == "revolute" else "kg"


class _MotorTerm(Term):
    """Base of the terms of a motor at phi = sum c_k q_k: its torque f acts on the joints as tau_k = c_k f.

    A subclass gives ``_parts``, f as terms of an arm whose only joint is the motor (``_motor``).
    """

    joints: tuple[Joint, ...]
    coefficients: Mapping[str, float] | tuple[tuple[str, float], ...]
    name: str

    def _set_coefficients(self) -> None:
        """Turn joints and coefficients into tuples; raise ModelError for wrong ones."""
        object.__setattr__(self, "coefficients", tuple((str(name), float(c)) for name, c in self._pairs))
        object.__setattr__(self, "joints", check_joints(self, self.joints))
        where, joint_names, coupled_names = f"Coupling {self.name!r}", [joint.name for joint in self.joints], set()
        for name, c in self._pairs:
            if name not in joint_names:
                raise ModelError(f"{where}: no joint {name!r}; {choices(name, joint_names)}")
            if name in coupled_names:
                raise ModelError(f"{where}: joint {name!r} is listed twice.")
            coupled_names.add(name)
            if not MIN_COEFFICIENT <= abs(c) <= MAX_COEFFICIENT:
                raise ModelError(
                    f"{where}: the coefficient of {name!r} is {c}; give one from {MIN_COEFFICIENT:g} to "
                    f"{MAX_COEFFICIENT:g} in size, or leave the joint out."
                )
        if not coupled_names:
            raise ModelError(f"{where}: no joint is coupled; give coefficients such as {{{joint_names[0]!r}: 1.0}}.")

    @property
    @abstractmethod
    def _parts(self) -> tuple[JointTerm, ...]:
        """The parts of f."""

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, p): at the joints that are coupled."""
        return np.repeat(self._coefficient_vector[:, None] != 0, len(self._parts), axis=1)

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y, shape (N, n, p), for q, dq, ddq (N, n) in rad or m and seconds."""
        # the parts are functions of phi = c'q, and their torque f acts on the joints as c f
        motor = self._motor_states(q, dq, ddq)
        f = np.concatenate([part.regressor(*motor) for part in self._parts], axis=2)
        return np.asarray(self._coefficient_vector[:, None] * f)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        """Return the derivatives of Y theta by q, dq and ddq, each (N, n, n)."""
        # chain rule of phi = c'q for the torques c f: the slopes of f by phi times c c'
        motor, outer = self._motor_states(q, dq, ddq), np.outer(self._coefficient_vector, self._coefficient_vector)
        slopes = [part.partials(*motor, x) for part, x in zip(self._parts, theta[:, None], strict=True)]
        return Partials(*(outer * sum(getattr(slope, wrt) for slope in slopes) for wrt in ("q", "dq", "ddq")))

    @property
    def _pairs(self) -> tuple[tuple[str, float], ...]:
        return tuple(self.coefficients.items()) if isinstance(self.coefficients, Mapping) else self.coefficients

    @property
    def _motor(self) -> Joint:
        """The motor as a joint, which slides where all of its joints do."""
        kinds = {joint.name: joint.kind for joint in self.joints}
        slides = all(kinds[name] == "prismatic" for name, _ in self._pairs)
        return Joint(self.name, "prismatic" if slides else "revolute")

    @cached_property
    def _coefficient_vector(self) -> Array:
        """The coefficients (n) of the joints, zero for those that are not coupled."""
        return np.array([dict(self._pairs).get(joint.name, 0.0) for joint in self.joints])

    def _motor_states(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
        c = self._coefficient_vector[:, None]
        return q @ c, dq @ c, ddq @ c

    def _motor_width(self, width: Array) -> float:
        """Return the width of the sign of dphi for those (n) of the joints: independent ones add as squares."""
        return float(np.linalg.norm(self._coefficient_vector * width))

    def _expression(self, parameter: Parameter) -> str:
        """Return what a parameter of a part is, at the motor."""
        position_text = " + ".join(f"{c:g} {name}" for name, c in self._pairs).replace("+ -", "- ")
        return f"{parameter.expression} of the motor at {position_text}"


@dataclass(frozen=True)
class CoupledMotor(_MotorTerm):
    """A motor coupled to several joints, phi = sum c_k q_k, with its own rotor inertia and friction.

    Its torque f = Ia ddphi + Fv dphi + Fc sign(dphi) + offset acts on the joints as tau_k = c_k f (principle of virtual
    work); the switches ``inertia``, ``viscous``, ``coulomb`` and ``offset`` choose its parts. ``coefficients`` maps
    joints to c_k: {"joint_5": 1, "joint_6": 1} for a wrist whose last gear is carried by the one before; {"shoulder":
    1, "elbow": -6} for an elbow motor on the first link. phi is in rad, or in m where all of the joints are prismatic.
    ``width`` and ``dead_band`` are those of ``Coulomb``, on dphi; ``values`` are nominal values, where known.

    Parameters are Ia_<name>, Fv_<name>, Fc_<name> and offset_<name>. Raises ModelError for an unknown joint, a
    coefficient that is zero or huge, no part, a wrong number of values, and as ``Coulomb`` does.

    >>> import dynident as dy
    >>> wrist = tuple(map(dy.Joint, ("joint_5", "joint_6")))
    >>> motor = dy.CoupledMotor(wrist, {"joint_5": 1, "joint_6": 1}, name="m6", coulomb=False)
    >>> [parameter.name for parameter in motor.parameters]
    ['Ia_m6', 'Fv_m6']
    """

    joints: tuple[Joint, ...] = field(repr=False)
    coefficients: Mapping[str, float] | tuple[tuple[str, float], ...]
    name: str
    inertia: bool = True
    viscous: bool = True
    coulomb: bool = True
    offset: bool = False
    width: float = 0.0
    dead_band: float = 0.0
    values: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        self._set_coefficients()
        where = f"Coupling {self.name!r}"
        if not self._parts:
            raise ModelError(f"{where}: no part is left; switch on one of inertia, viscous, coulomb and offset.")
        if self.values is not None:
            object.__setattr__(self, "values", tuple(self.values))
            if len(self.values) != len(self._parts):
                names = ", ".join(parameter.name for part in self._parts for parameter in part.parameters)
                raise ModelError(f"{where}: {len(self.values)} values for {len(self._parts)} parameters ({names}).")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of the parts that are switched on, in the order of the switches."""
        parameters = [parameter for part in self._parts for parameter in part.parameters]
        values = self.values or (None,) * len(parameters)
        return tuple(
            replace(parameter, expression=self._expression(parameter), value=value)
            for parameter, value in zip(parameters, values, strict=True)
        )

    @property
    def equations(self) -> tuple[Equation, ...]:
        """The equations of the motor, one for each part that is switched on."""
        laws = [law for part in self._parts for law in part.equations]
        return tuple(replace(law, on=self._pairs, motor=self.name) for law in laws)

    @property
    def discontinuous(self) -> bool:
        """Whether the torque jumps with the sign of the motor's velocity."""
        return self.coulomb and not (self.width or self.dead_band)

    def with_smooth_sign(self, width: Array) -> tuple[CoupledMotor]:
        """Return the motor with the ``width`` of its sign propagated from those (n) of its joints."""
        return (replace(self, width=self._motor_width(width)),)

    @cached_property
    def _parts(self) -> tuple[PerJoint, ...]:
        """The parts as terms of an arm whose only joint is the motor."""
        motor = (self._motor,)
        # built even where it is switched off, so that its width and dead band are checked
        coulomb = Coulomb(motor, width=self.width, dead_band=self.dead_band)
        switches = (self.inertia, self.viscous, self.coulomb, self.offset)
        parts = (RotorInertia(motor), Viscous(motor), coulomb, Offset(motor))
        return tuple(part for part, switch in zip(parts, switches, strict=True) if switch)


Law = Literal["coulomb", "stribeck", "power", "asymmetric_viscous"]
LAWS: Mapping[str, type[JointTerm]] = {
    "coulomb": Coulomb,
    "stribeck": Stribeck,
    "power": Power,
    "asymmetric_viscous": AsymmetricViscous,
}


@dataclass(frozen=True)
class CoupledFriction(_MotorTerm):
    """Friction of a motor at phi = sum c_k q_k: a torque f(dphi) of the motor, c_k f on each of its joints.

    ``law`` names f by its kind, with the constants of its shape in ``settings``, in units of dphi (rad/s, or m/s where
    all of the joints slide). ``coefficients`` and ``name`` of the motor are as in ``CoupledMotor``, whose friction this
    adds to; parameters are named after law and motor. Raises ModelError for an unknown law or constant, and as
    ``CoupledMotor`` and the law do.

    >>> import dynident as dy
    >>> wrist = tuple(map(dy.Joint, ("joint_5", "joint_6")))
    >>> both = {"joint_5": 1, "joint_6": 1}
    >>> more = dy.models.CoupledFriction(wrist, both, name="m6", law="power", settings={"exponent": 0.3})
    >>> [parameter.name for parameter in more.parameters]
    ['power_m6']
    """

    joints: tuple[Joint, ...] = field(repr=False)
    coefficients: Mapping[str, float] | tuple[tuple[str, float], ...]
    name: str
    law: Law
    settings: Mapping[str, float] | tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        self._set_coefficients()
        settings = self.settings
        pairs = settings.items() if isinstance(settings, Mapping) else settings
        object.__setattr__(self, "settings", tuple((str(name), value) for name, value in pairs))
        where = f"Friction of the coupling {self.name!r}"
        if self.law not in LAWS:
            raise ModelError(f"{where}: no law {self.law!r}; {choices(str(self.law), get_args(Law))}")
        constant_names = tuple(LAWS[self.law].constants)
        for name, _ in self._constants:
            if name not in constant_names:
                hint = choices(name, constant_names) if constant_names else "leave it out."
                raise ModelError(f"{where}: {self.law} has no constant {name!r}; {hint}")
        required = [
            law_field.name
            for law_field in fields(LAWS[self.law])
            if law_field.name in constant_names and law_field.default is MISSING
        ]
        if missing := [name for name in required if name not in dict(self._constants)]:
            raise ModelError(f"{where}: {self.law} needs its constant {missing[0]!r} in `settings`.")
        # build the law once, so that it checks its constants
        _ = self._friction

    @property
    def acts_on(self) -> tuple[str, ...]:
        """The joints that are coupled."""
        return tuple(name for name, _ in self._pairs)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of the law."""
        (parameter,) = self._friction.parameters
        return (replace(parameter, name=f"{self.law}_{self.name}", expression=self._expression(parameter)),)

    @property
    def equations(self) -> tuple[Equation, ...]:
        """The equation of the motor."""
        name = self.parameters[0].name
        laws = self._friction.equations
        return tuple(replace(law, parameters=(name,), on=self._pairs, motor=self.name) for law in laws)

    @property
    def discontinuous(self) -> bool:
        """Whether the torque jumps with the sign of the motor's velocity."""
        return self._friction.discontinuous

    def with_smooth_sign(self, width: Array) -> tuple[CoupledFriction]:
        """Return the friction with the ``width`` of its sign propagated from those (n) of its joints."""
        if not self.discontinuous:
            return (self,)
        return (replace(self, settings=dict(self._constants) | {"width": self._motor_width(width)}),)

    def numpy_source(self, name: str, theta: Array) -> str:
        """Return the text of a function of q, dq and ddq that gives Y theta."""
        return (
            f"def {name}(q, dq, ddq):\n"
            f"    c = np.array({self._coefficient_vector.tolist()!r})[:, None]\n"
            f"    q, dq, ddq = q @ c, dq @ c, ddq @ c\n"
            f"    return {theta.tolist()[0]!r} * ({self._friction.formula()}) @ c.T\n"
        )

    @property
    def _constants(self) -> tuple[tuple[str, float], ...]:
        return tuple(self.settings.items()) if isinstance(self.settings, Mapping) else self.settings

    @cached_property
    def _friction(self) -> JointTerm:
        """The law as a term of an arm whose only joint is the motor."""
        return LAWS[self.law]((self._motor,), **dict(self._constants))  # type: ignore[arg-type]

    @property
    def _parts(self) -> tuple[JointTerm, ...]:
        return (self._friction,)
