"""Motors: rotor inertia, and motors coupled to several joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, choices
from dynident.models.equation import Equation
from dynident.models.friction import Coulomb, Offset, PerJoint, Viscous
from dynident.models.term import Joint, Parameter, Partials

__all__ = ["CoupledMotor", "RotorInertia"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RotorInertia(PerJoint):
    """Rotor inertia on the joint's side of the gear, tau_j = Ia_j ddq_j, in kg m^2 or kg; fields as in ``Viscous``.

    The gyroscopic torques of the rotor are neglected: they are small where the gear ratio is large (Siciliano et al.
    2009, "Robotics", sec. 7.3).

    >>> import dynident as dy
    >>> dy.RotorInertia((dy.Joint("elbow"),)).parameters[0].unit
    'kg m^2'
    """

    symbol = "Ia"
    role = "rotor"
    of = "ddq"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return "rotor inertia: torque per ddq"

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return "kg m^2" if joint.kind == "revolute" else "kg"

    def law(self, joint: Joint) -> Equation:  # noqa: ARG002
        """Return the torque at a joint as an equation."""
        return Equation("I_a * ddq", ("I_a",))

    def shape(self, ddq: Array, /) -> Array:
        """Return the torque per unit of the parameter."""
        return ddq

    def slope(self, ddq: Array, /) -> Array:
        """Return the derivative of ``shape``."""
        return np.ones_like(ddq)


@dataclass(frozen=True)
class CoupledMotor:
    """A motor coupled to several joints, phi = sum c_k q_k, with its own rotor inertia and friction.

    Its torque f = Ia ddphi + Fv dphi + Fc sign(dphi) + offset acts on the joints as tau_k = c_k f (principle of virtual
    work); the switches ``inertia``, ``viscous``, ``coulomb`` and ``offset`` choose its parts. ``coefficients`` maps
    joints to c_k: {"joint_5": 1, "joint_6": 1} for a wrist whose last gear is carried by the one before; {"shoulder":
    1, "elbow": -6} for an elbow motor on the first link. phi is in rad, or in m where all of the joints are prismatic.
    ``width`` and ``dead_band`` are those of ``Coulomb``, on dphi; ``values`` are nominal values, where known.

    Parameters are Ia_<name>, Fv_<name>, Fc_<name> and offset_<name>. Raises ModelError for an unknown joint, a
    coefficient that is zero or not finite, no part, a wrong number of values, and as ``Coulomb`` does.

    >>> import dynident as dy
    >>> wrist = tuple(map(dy.Joint, ("joint_5", "joint_6")))
    >>> motor = dy.CoupledMotor(wrist, {"joint_5": 1, "joint_6": 1}, name="m6", coulomb=False)
    >>> [one.name for one in motor.parameters]
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
        given = self.coefficients
        pairs = given.items() if isinstance(given, Mapping) else given
        object.__setattr__(self, "coefficients", tuple((str(name), float(c)) for name, c in pairs))
        object.__setattr__(self, "joints", tuple(self.joints))
        where = f"Coupling {self.name!r}"
        self._check_pairs(where)
        if not self._parts:
            raise ModelError(f"{where}: no part is left; switch on one of inertia, viscous, coulomb and offset.")
        if self.values is not None:
            object.__setattr__(self, "values", tuple(self.values))
            if len(self.values) != len(self._parts):
                names = ", ".join(parameter.name for part in self._parts for parameter in part.parameters)
                raise ModelError(f"{where}: {len(self.values)} values for {len(self._parts)} parameters ({names}).")

    def _check_pairs(self, where: str) -> None:
        known, seen = [joint.name for joint in self.joints], set()
        for name, c in self._pairs:
            if name not in known:
                raise ModelError(f"{where}: no joint {name!r}; {choices(name, known)}")
            if name in seen:
                raise ModelError(f"{where}: joint {name!r} is listed twice.")
            seen.add(name)
            if c == 0 or not np.isfinite(c):
                raise ModelError(
                    f"{where}: the coefficient of {name!r} is {c}; give a finite, nonzero one, or leave the joint out."
                )
        if not seen:
            raise ModelError(f"{where}: no joint is coupled; give coefficients such as {{{known[0]!r}: 1.0}}.")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of the parts that are switched on, in the order of the switches."""
        found = [parameter for part in self._parts for parameter in part.parameters]
        motion = " + ".join(f"{c:g} {name}" for name, c in self._pairs).replace("+ -", "- ")
        values = self.values or (None,) * len(found)
        return tuple(
            replace(parameter, expression=f"{parameter.expression} of the motor at {motion}", value=value)
            for parameter, value in zip(found, values, strict=True)
        )

    @property
    def equations(self) -> tuple[Equation, ...]:
        """The equations of the motor, one for each part that is switched on."""
        own = [law for part in self._parts for law in part.equations]
        return tuple(replace(law, on=self._pairs, motor=self.name) for law in own)

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, p): at the joints that are coupled."""
        return np.repeat(self._vector[:, None] != 0, len(self._parts), axis=1)

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y, shape (N, n, p), for q, dq, ddq (N, n) in rad or m and seconds."""
        motor = self._motor(q, dq, ddq)
        f = np.concatenate([part.regressor(*motor) for part in self._parts], axis=2)
        return np.asarray(self._vector[:, None] * f)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        """Return the derivatives of Y theta by q, dq and ddq, each (N, n, n)."""
        motor, outer = self._motor(q, dq, ddq), np.outer(self._vector, self._vector)
        slopes = [part.partials(*motor, x) for part, x in zip(self._parts, theta[:, None], strict=True)]
        return Partials(*(outer * sum(getattr(slope, wrt) for slope in slopes) for wrt in ("q", "dq", "ddq")))

    @property
    def discontinuous(self) -> bool:
        """Whether the torque jumps with the sign of the motor's velocity."""
        return self.coulomb and not (self.width or self.dead_band)

    def with_smooth_sign(self, width: Array) -> tuple[CoupledMotor]:
        """Return the motor with the ``width`` of its sign propagated from those (n) of its joints."""
        return (replace(self, width=float(np.linalg.norm(self._vector * width))),)

    @property
    def _pairs(self) -> tuple[tuple[str, float], ...]:
        return tuple(self.coefficients.items()) if isinstance(self.coefficients, Mapping) else self.coefficients

    @cached_property
    def _vector(self) -> Array:
        """The coefficients (n) of the joints, zero for those that are not coupled."""
        return np.array([dict(self._pairs).get(joint.name, 0.0) for joint in self.joints])

    @cached_property
    def _parts(self) -> tuple[PerJoint, ...]:
        """The parts as terms of an arm whose only joint is the motor."""
        kinds = {joint.name: joint.kind for joint in self.joints}
        slides = all(kinds[name] == "prismatic" for name, _ in self._pairs)
        motor = (Joint(self.name, "prismatic" if slides else "revolute"),)
        # built even where it is switched off, so that its width and dead band are checked
        coulomb = Coulomb(motor, width=self.width, dead_band=self.dead_band)
        switches = (self.inertia, self.viscous, self.coulomb, self.offset)
        parts = (RotorInertia(motor), Viscous(motor), coulomb, Offset(motor))
        return tuple(part for part, switch in zip(parts, switches, strict=True) if switch)

    def _motor(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
        c = self._vector[:, None]
        return q @ c, dq @ c, ddq @ c
