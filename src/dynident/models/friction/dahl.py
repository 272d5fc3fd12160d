"""Dahl's friction: presliding, in which a joint moves like a spring before it slides."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from dynident.models.friction.joint_term import Constant, JointTerm, Slopes
from dynident.models.term import Joint, Past
from dynident.smoothers import BY_JOINT

__all__ = ["LENGTH", "Dahl", "Length", "presliding"]

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

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:  # noqa: ARG002
        """Return the torque per unit of each parameter (N, p)."""
        return memory[0]

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Slopes:  # noqa: ARG002
        """Return the derivatives at constant memory, zero."""
        return None, None, None


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
    kept = np.exp(-np.abs(ways) / length)
    start = np.zeros(len(columns)) if past.start is None else past.start[: len(columns)]
    out = np.empty((len(q), len(columns)))
    if len(q):
        for j, (stays, goes) in enumerate(zip(kept.T, (np.sign(ways) * (1 - kept)).T, strict=True)):
            steps = zip(stays.tolist(), goes.tolist(), strict=True)
            u = accumulate(steps, lambda u, step: step[0] * u + step[1], initial=float(start[j]))
            out[:, j] = list(u)[::2]
    return out
