"""Slow drift of a torque while a recording lasts, as by temperature."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from dynident.models.equation import Equation
from dynident.models.friction.joint_term import Constant, JointTerm, Slopes
from dynident.models.term import Joint, Past
from dynident.smoothers import BY_JOINT

__all__ = ["Drift"]

Array = NDArray[np.float64]
Time = Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT]


@dataclass(frozen=True)
class Drift(JointTerm):
    """Drift of a torque, tau_j = drift_j (1 - exp(-t / T_j)), in N m or N, with t (s) from the start of the recording.

    ``time`` T (s) is that in which most of the drift is over, of all joints or by joint; ``on``, ``names``, ... as in
    ``Viscous``. Every recording starts cold: this suits those that were made after the same pause.

    >>> import dynident as dy
    >>> from dynident.models import Drift
    >>> Drift((dy.Joint("elbow"),), time=120.0).parameters[0].expression
    'torque by which the joint drifts, in about 120 s'
    """

    constants: ClassVar[Mapping[str, Constant]] = {"time": Constant("a time above 0, in s")}
    time: Time = 60.0

    @property
    def memory(self) -> int:
        """The share of the drift that is over, for each joint in ``on``."""
        return len(self.acts_on)

    def remember(self, past: Past) -> Array:
        """Return the share of the drift that is over at the samples of a motion, shape (N, m)."""
        start = 0.0 if past.start is None else past.start
        since = (past.t - past.t[:1])[:, None]
        return np.asarray(1.0 - (1.0 - start) * np.exp(-since / self.by_column("time")))

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameter of a joint."""
        time = self.constant("time", joint.name)
        yield f"drift_{joint.name}", joint.effort, f"torque by which the joint drifts, in about {time:g} s"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        time = "T", self.constant("time", joint.name), "s"
        return Equation("D * (1 - exp(-t / T))", ("D",), (time,))

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:  # noqa: ARG002
        """Return the torque per unit of each parameter (N, p)."""
        return memory[0]

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Slopes:  # noqa: ARG002
        """Return the derivatives, zero."""
        return None, None, None
