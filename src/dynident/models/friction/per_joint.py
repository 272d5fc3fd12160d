"""The base of terms with one parameter for each joint, by its position, velocity or acceleration."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dynident.models.friction.joint_term import JointTerm
from dynident.models.term import Joint

__all__ = ["PerJoint"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PerJoint(JointTerm):
    """Base of terms with one parameter for each joint in ``on``: tau_j = theta_j * shape(dq_j), or of q_j or ddq_j.

    A subclass defines ``shape``, its derivative ``slope``, and ``meaning``; ``symbol`` is the prefix of the parameters'
    names, ``role`` that of ``Parameter``, ``of`` what ``shape`` depends on; ``formula`` is ``shape`` as text, for
    exports. Further fields are settings; those in ``constants`` may be given by joint, see ``JointTerm``.
    """

    symbol: ClassVar[str]
    of: ClassVar[Literal["q", "dq", "ddq"]] = "dq"

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameter of a joint."""
        yield f"{self.symbol}_{joint.name}", self.unit(joint), self.meaning()

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:  # noqa: ARG002
        """Return the torque per unit of each parameter (N, p)."""
        return self.shape({"q": q, "dq": dq, "ddq": ddq}[self.of])

    def slopes(
        self,
        q: Array,
        dq: Array,
        ddq: Array,
        /,
        *memory: Array,  # noqa: ARG002
    ) -> tuple[Array | None, Array | None, Array | None]:
        """Return the derivatives of ``shapes``; only that by ``of`` is not zero."""
        slope = self.slope({"q": q, "dq": dq, "ddq": ddq}[self.of])
        by_q, by_dq, by_ddq = (slope if self.of == name else None for name in ("q", "dq", "ddq"))
        return by_q, by_dq, by_ddq

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return joint.effort

    @abstractmethod
    def meaning(self) -> str:
        """Return the meaning of the parameter."""

    @abstractmethod
    def shape(self, dq: Array, /) -> Array:
        """Return the torque per unit of the parameter."""

    @abstractmethod
    def slope(self, dq: Array, /) -> Array:
        """Return the derivative of ``shape``."""
