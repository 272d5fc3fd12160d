"""Friction that grows with the load: the torque that a drive carries presses its teeth and bearings together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dynident.models.equation import Equation
from dynident.models.friction.dahl import LENGTH, Length, bent, presliding
from dynident.models.friction.dry_friction import DryFriction
from dynident.models.friction.joint_term import Constant, JointTerm, Slopes
from dynident.models.friction.ripple import Ripple
from dynident.models.friction.viscous import Viscous
from dynident.models.term import Joint, Past

__all__ = ["LoadCoulomb", "LoadDahl", "LoadRipple", "LoadViscous", "RemembersLoad"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RemembersLoad(JointTerm):
    """Base of friction by the load of the joints in ``on``: the torque of the bodies, N m or N, by a first fit."""

    needs_load: ClassVar[bool] = True

    @property
    def memory(self) -> int:
        """The load at the joint of each parameter."""
        return len(self._columns)

    def remember(self, past: Past) -> Array:
        """Return the load at the samples of a motion, shape (N, m)."""
        return past.load[:, self._columns]

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source, of q, dq, ddq and the absolute ``load``."""
        return f"load * ({plain})" if (plain := super().formula()) else ""

    def numpy_source(self, name: str, theta: Array) -> str:
        """Return the text of a function that gives Y theta; the load is that of a function ``_load(q, dq, ddq)``."""
        load = "    load = np.abs(_load(q, dq, ddq))[:, joints]\n"
        head, rest = super().numpy_source(name, theta).split("    q, dq, ddq = ", 1)
        return f"{head}{load}    q, dq, ddq = {rest}"


@dataclass(frozen=True)
class LoadCoulomb(RemembersLoad, DryFriction):
    """Coulomb friction by the load, tau_j = fc_j abs(load_j) sign(dq_j), without unit.

    ``load`` is the torque of the bodies by a first fit, so that the torque is linear in the parameters; ``width`` > 0
    (rad/s, m/s) makes the sign tanh(dq / width); ``on``, ``names``, ... as in ``Viscous``.

    >>> import dynident as dy
    >>> from dynident.models import LoadCoulomb
    >>> LoadCoulomb((dy.Joint("elbow"),), width=0.01).parameters[0].name
    'fc_elbow'
    """

    symbol = "fc"
    role = "coulomb"

    def unit(self, joint: Joint) -> str:  # noqa: ARG002
        """Return the unit of a joint's parameter."""
        return "1"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return f"Coulomb friction: torque per abs(load) {self.sign_words()}"

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source."""
        return f"load * {self.sign_source()}"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        sign, width = self.sign_law(joint, "w_l")
        return Equation(f"f_c * abs(load) * {sign}", ("f_c",), width)

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:
        """Return the torque per unit of each parameter (N, p)."""
        return np.abs(memory[0]) * super().shapes(q, dq, ddq)

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Slopes:  # noqa: ARG002
        """Return the derivatives at constant load."""
        return None, np.abs(memory[0]) * self.slope(dq), None


@dataclass(frozen=True)
class LoadViscous(RemembersLoad, Viscous):
    """Viscous friction by the load, tau_j = fv_j abs(load_j) dq_j, in s/rad or s/m; ``load`` as in ``LoadCoulomb``.

    >>> import dynident as dy
    >>> from dynident.models import LoadViscous
    >>> LoadViscous((dy.Joint("elbow"),)).parameters[0].unit
    's/rad'
    """

    symbol = "fv"

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return f"s/{joint.unit}"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return "viscous friction: torque per abs(load) dq"

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source."""
        return "load * dq"

    def law(self, joint: Joint) -> Equation:  # noqa: ARG002
        """Return the torque at a joint as an equation."""
        return Equation("f_v * abs(load) * dq", ("f_v",))

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:
        """Return the torque per unit of each parameter (N, p)."""
        return np.abs(memory[0]) * super().shapes(q, dq, ddq)

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Slopes:  # noqa: ARG002
        """Return the derivatives at constant load."""
        return None, np.abs(memory[0]) * self.slope(dq), None


@dataclass(frozen=True)
class LoadDahl(JointTerm):
    """Dahl's friction by the load, tau_j = fd_j abs(load_j) z_j / s_j, without unit; z as in ``Dahl``, ``load`` as in
    ``LoadCoulomb``.

    >>> import dynident as dy
    >>> from dynident.models import LoadDahl
    >>> LoadDahl((dy.Joint("elbow"),), length=0.003).memory
    2
    """

    needs_load: ClassVar[bool] = True
    constants: ClassVar[Mapping[str, Constant]] = {"length": LENGTH}
    length: Length = 0.005
    role = "coulomb"

    @property
    def memory(self) -> int:
        """The states z / s of all joints in ``on``, then their loads."""
        return 2 * len(self.acts_on)

    def remember(self, past: Past) -> Array:
        """Return z / s and the load at the samples of a motion, shape (N, m)."""
        bent = presliding(past, self._columns, self.by_column("length"))
        return np.concatenate([bent, past.load[:, self._columns]], axis=1)

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameter of a joint."""
        length = self.constant("length", joint.name)
        yield f"fd_{joint.name}", "1", f"Dahl friction over {length:g} {joint.unit}: torque per abs(load)"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        return Equation("f_d * abs(load) * z", ("f_d",), *bent(self.constant("length", joint.name), joint, "s_l"))

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:  # noqa: ARG002
        """Return the torque per unit of each parameter (N, p)."""
        bent, load = np.split(memory[0], 2, axis=1)
        return np.asarray(np.abs(load) * bent)

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Slopes:  # noqa: ARG002
        """Return the derivatives at constant memory, zero."""
        return None, None, None


@dataclass(frozen=True)
class LoadRipple(RemembersLoad, Ripple):
    """Ripple by the load, tau_j = abs(load_j) times that of ``Ripple``, without unit; ``load`` as in ``LoadCoulomb``.

    >>> import dynident as dy
    >>> from dynident.models import LoadRipple
    >>> LoadRipple((dy.Joint("elbow"),), cycles=100).parameters[0].expression
    'ripple: torque per abs(load) sin(100 q)'
    """

    symbol: ClassVar[str] = "load_ripple"
    letters: ClassVar[tuple[str, str, str]] = ("alpha", "beta", "m")

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameters of a joint."""
        for name, _, meaning in super().described(joint):
            yield name, "1", meaning.replace("torque per", "torque per abs(load)")

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        law = super().law(joint)
        return replace(law, torque=f"abs(load) * ({law.torque})")

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:
        """Return the torque per unit of each parameter (N, p)."""
        return np.abs(memory[0]) * super().shapes(q, dq, ddq)

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> tuple[Array, Array, None]:
        """Return the derivatives at constant load."""
        by_q, by_dq, _ = super().slopes(q, dq, ddq)
        return np.abs(memory[0]) * by_q, np.abs(memory[0]) * by_dq, None
