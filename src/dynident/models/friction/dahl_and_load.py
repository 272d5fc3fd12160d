"""Friction that grows with the load: the torque that a drive carries presses its teeth and bearings together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt

from dynident.models.friction.dry_friction import WIDTH, DryFriction
from dynident.models.friction.joint_term import Constant, JointTerm, PerJoint, Viscous
from dynident.models.friction.joint_torques import Ripple
from dynident.models.term import Equation, Joint, Past
from dynident.motion.smoothers import BY_JOINT
from dynident.runtime.arrays import Array

Length = Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT]
LENGTH = Constant("a length above 0, in rad or m", unit="{unit}")


@dataclass(frozen=True)
class Dahl(PerJoint):
    """Dahl's friction, tau_j = Fc_j z_j / s_j with dz_j/dt = dq_j - abs(dq_j) z_j / s_j, in N m or N.

    z is how far the contact is bent and s its ``length`` (rad or m; of all joints or by joint), the motion after a
    reversal in which the torque comes within 1/e of its other sign. After a few lengths the torque is Coulomb friction
    Fc sign(dq); at rest it stays as it was. z / s is what the term remembers; it is 0 where a recording begins. ``on``,
    ``names``, ... as in ``Viscous``. Reference: Dahl (1968), "A solid friction model".

    >>> import dynident as dy
    >>> from dynident.models.friction import Dahl
    >>> Dahl((dy.Joint("elbow"),), length=0.003).parameters[0].expression
    'Dahl friction over 0.003 rad'
    """

    title: ClassVar[str] = "Dahl friction"

    constants: ClassVar[Mapping[str, Constant]] = {"length": replace(LENGTH, letter="s_d")}
    length: Length = 0.005
    states: ClassVar[tuple[str, ...]] = ("z",)
    symbol, letter = "Fd", "F_d"
    role = "coulomb"
    law = "z"
    words = "Dahl friction over {length:g} {unit}"

    def remember_state(self, past: Past) -> Array:
        """Return z / s at the samples of a motion, shape (N, p)."""
        return presliding(past, self._columns, self.by_column("length"))

    def equation(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation, with ``z`` for z / s."""
        torque, letter = f"{self.letter} * {self.law}", self.constants["length"].letter
        length = letter, self.constant("length", joint.name), joint.unit
        return Equation(torque, (self.letter,), (length,), (("dz", f"(dq - abs(dq) * z) / {letter}"),))


def presliding(past: Past, columns: list[int], length: Array) -> Array:
    """Return u = z / s (N, m), by du = (sign(dq) - u) abs(dq) / s, of the joints ``columns`` with lengths s (m).

    It depends on the path alone, so that it is exact between samples as long as a joint does not reverse; where it
    does, the way to the reversal and back is that of constant acceleration.
    """
    q, dq = past.q[:, columns], past.dq[:, columns]
    h, travel = np.diff(past.t)[:, None], np.diff(q, axis=0)
    # abs(dq) changes its slope at a reversal: split such a step there, so that each leg has one direction
    reverses = dq[:-1] * dq[1:] < 0
    fraction = dq[:-1] / np.where(reverses, dq[:-1] - dq[1:], 1.0)  # of the step that lies before the reversal
    first_leg = np.where(reverses, 0.5 * dq[:-1] * fraction * h, travel)
    legs = np.stack([first_leg, travel - first_leg], axis=1).reshape(-1, len(columns))
    start = np.zeros(len(columns)) if past.start is None else past.start[: len(columns)]
    out = np.empty((len(q), len(columns)))
    if len(q):
        for j, travel in enumerate(legs.T):
            out[:, j] = _follow_path(travel, float(length[j]), float(start[j]))[::2]
    return out


def _follow_path(way: Array, length: float, start: float) -> Array:
    """Return u (K + 1) along K steps of the path of one joint, each in one direction.

    Only the reversals are gone through one by one.
    """
    sign = np.sign(way)[np.maximum.accumulate(np.where(way != 0, np.arange(len(way)), 0))]  # no reversal at rest
    run_starts = np.flatnonzero(np.diff(sign, prepend=np.nan))
    direction = sign[run_starts]
    # between reversals u decays with the length of the path towards the direction: a recursion over the runs suffices
    path = np.concatenate([[0.0], np.cumsum(np.abs(way))])
    run_decay = np.exp(-np.diff(path[np.append(run_starts, len(way))]) / length)
    runs = zip(direction.tolist(), run_decay.tolist(), strict=True)
    u = list(accumulate(runs, lambda u, run: run[0] + (u - run[0]) * run[1], initial=start))
    run = np.repeat(np.arange(len(run_starts)), np.diff(np.append(run_starts, len(way))))
    decay = np.exp(-(path[1:] - path[run_starts][run]) / length)
    return np.concatenate([[start], direction[run] + (np.array(u[:-1])[run] - direction[run]) * decay])


@dataclass(frozen=True)
class RemembersLoad(JointTerm):
    """Base of friction by the load of the joints in ``on``: the torque of the bodies, N m or N, by a first fit."""

    needs_load: ClassVar[bool] = True
    states: ClassVar[tuple[str, ...]] = ("load",)


@dataclass(frozen=True)
class LoadCoulomb(RemembersLoad, DryFriction):
    """Coulomb friction by the load, tau_j = fc_j abs(load_j) sign(dq_j), without unit.

    ``load`` is the torque of the bodies by a first fit, so that the torque is linear in the parameters; ``width`` > 0
    (rad/s, m/s) makes the sign tanh(dq / width); ``on``, ``names``, ... as in ``Viscous``.

    >>> import dynident as dy
    >>> from dynident.models.friction import LoadCoulomb
    >>> LoadCoulomb((dy.Joint("elbow"),), width=0.01).parameters[0].name
    'fc_elbow'
    """

    title: ClassVar[str] = "Coulomb friction by the load"

    constants: ClassVar[Mapping[str, Constant]] = {"width": replace(WIDTH, letter="w_l")}
    symbol = "fc"
    role = "coulomb"
    law = "abs(load) * sign(dq, width)"
    words = "Coulomb friction: torque per abs(load) {sign}"
    unit_text = "1"


@dataclass(frozen=True)
class LoadViscous(RemembersLoad, Viscous):
    """Viscous friction by the load, tau_j = fv_j abs(load_j) dq_j, in s/rad or s/m; ``load`` as in ``LoadCoulomb``.

    >>> import dynident as dy
    >>> from dynident.models.friction import LoadViscous
    >>> LoadViscous((dy.Joint("elbow"),)).parameters[0].unit
    's/rad'
    """

    title: ClassVar[str] = "viscous friction by the load"

    symbol = "fv"
    law = "abs(load) * dq"
    words = "viscous friction: torque per abs(load) dq"
    unit_text = "s/{unit}"


@dataclass(frozen=True)
class LoadDahl(RemembersLoad, Dahl):
    """Dahl's friction by the load, tau_j = fd_j abs(load_j) z_j / s_j, without unit; z as in ``Dahl``, ``load`` as in
    ``LoadCoulomb``.

    >>> import dynident as dy
    >>> from dynident.models.friction import LoadDahl
    >>> LoadDahl((dy.Joint("elbow"),), length=0.003).memory
    2
    """

    title: ClassVar[str] = "Dahl friction by the load"

    constants: ClassVar[Mapping[str, Constant]] = {"length": replace(LENGTH, letter="s_l")}
    states: ClassVar[tuple[str, ...]] = ("z", "load")
    symbol, letter = "fd", "f_d"
    law = "abs(load) * z"
    words = "Dahl friction over {length:g} {unit}: torque per abs(load)"
    unit_text = "1"


@dataclass(frozen=True)
class LoadRipple(RemembersLoad, Ripple):
    """Ripple by the load, tau_j = abs(load_j) times that of ``Ripple``, without unit; ``load`` as in ``LoadCoulomb``.

    >>> import dynident as dy
    >>> from dynident.models.friction import LoadRipple
    >>> LoadRipple((dy.Joint("elbow"),), cycles=100).parameters[0].expression
    'ripple: torque per abs(load) sin(100 q)'
    """

    title: ClassVar[str] = "ripple by the load"

    law = f"abs(load) * {Ripple.law}"
    symbol: ClassVar[str] = "load_ripple"
    letters: ClassVar[tuple[str, str, str]] = ("alpha", "beta", "m")

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameters of a joint."""
        for name, _, meaning in super().described(joint):
            yield name, "1", meaning.replace("torque per", "torque per abs(load)")

    def equation(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        equation = super().equation(joint)
        return replace(equation, torque=f"abs(load) * ({equation.torque})")
