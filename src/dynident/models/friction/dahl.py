"""Dahl's friction: presliding, in which a joint moves like a spring before it slides."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from dynident.models.equation import Equation
from dynident.models.friction.joint_term import Constant, JointTerm, Slopes
from dynident.models.term import Joint, Past
from dynident.smoothers import BY_JOINT

__all__ = ["LENGTH", "Dahl", "Length", "bent", "presliding"]

Array = NDArray[np.float64]
Length = Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT]
LENGTH = Constant("a length above 0, in rad or m")


@dataclass(frozen=True)
class Dahl(JointTerm):
    """Dahl's friction, tau_j = Fc_j z_j / s_j with dz_j/dt = dq_j - abs(dq_j) z_j / s_j, in N m or N.

    z is how far the contact is bent and s its ``length`` (rad or m; of all joints or by joint), the motion after a
    reversal in which the torque comes within 1/e of its other sign. After a few lengths the torque is Coulomb friction
    Fc sign(dq); at rest it stays as it was. z / s is what the term remembers; it is 0 where a recording begins. ``on``,
    ``names``, ... as in ``Viscous``. Reference: Dahl (1968), "A solid friction model".

    >>> import dynident as dy
    >>> from dynident.models import Dahl
    >>> Dahl((dy.Joint("elbow"),), length=0.003).parameters[0].expression
    'Dahl friction over 0.003 rad'
    """

    constants: ClassVar[Mapping[str, Constant]] = {"length": LENGTH}
    length: Length = 0.005
    role = "coulomb"

    @property
    def memory(self) -> int:
        """One state for each joint in ``on``."""
        return len(self.acts_on)

    def remember(self, past: Past) -> Array:
        """Return z / s at the samples of a motion, shape (N, m)."""
        return presliding(past, self._columns, self.by_column("length"))

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameter of a joint."""
        length = self.constant("length", joint.name)
        yield f"Fd_{joint.name}", joint.effort, f"Dahl friction over {length:g} {joint.unit}"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        return Equation("F_d * z", ("F_d",), *bent(self.constant("length", joint.name), joint, "s_d"))

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:  # noqa: ARG002
        """Return the torque per unit of each parameter (N, p)."""
        return memory[0]

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Slopes:  # noqa: ARG002
        """Return the derivatives at constant memory, zero."""
        return None, None, None


def bent(
    length: float, joint: Joint, symbol: str
) -> tuple[tuple[tuple[str, float, str], ...], tuple[tuple[str, str], ...]]:
    """Return constant and state of presliding as an equation has them, with ``z`` for z / s."""
    return ((symbol, length, joint.unit),), (("dz", f"(dq - abs(dq) * z) / {symbol}"),)


def presliding(past: Past, columns: list[int], length: Array) -> Array:
    """Return u = z / s (N, m), by du = (sign(dq) - u) abs(dq) / s, of the joints ``columns`` with lengths s (m).

    It depends on the path alone, so that it is exact between samples as long as a joint does not reverse; where it
    does, the way to the reversal and back is that of constant acceleration.
    """
    q, dq = past.q[:, columns], past.dq[:, columns]
    h, way = np.diff(past.t)[:, None], np.diff(q, axis=0)
    turns = dq[:-1] * dq[1:] < 0
    share = dq[:-1] / np.where(turns, dq[:-1] - dq[1:], 1.0)  # of the step that lies before the reversal
    first = np.where(turns, 0.5 * dq[:-1] * share * h, way)
    ways = np.stack([first, way - first], axis=1).reshape(-1, len(columns))
    start = np.zeros(len(columns)) if past.start is None else past.start[: len(columns)]
    out = np.empty((len(q), len(columns)))
    if len(q):
        for j, way in enumerate(ways.T):
            out[:, j] = _along(way, float(length[j]), float(start[j]))[::2]
    return out


def _along(way: Array, length: float, start: float) -> Array:
    """Return u (K + 1) along K steps of a path of one joint, each in one direction; the loop is over the reversals."""
    sign = np.sign(way)[np.maximum.accumulate(np.where(way != 0, np.arange(len(way)), 0))]  # no reversal at rest
    first = np.flatnonzero(np.diff(sign, prepend=np.nan))
    to = sign[first]
    path = np.concatenate([[0.0], np.cumsum(np.abs(way))])
    kept = np.exp(-np.diff(path[np.append(first, len(way))]) / length)
    runs = zip(to.tolist(), kept.tolist(), strict=True)
    u = list(accumulate(runs, lambda u, run: run[0] + (u - run[0]) * run[1], initial=start))
    run = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(way))))
    away = np.exp(-(path[1:] - path[first][run]) / length)
    return np.concatenate([[start], to[run] + (np.array(u[:-1])[run] - to[run]) * away])
