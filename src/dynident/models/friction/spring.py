"""Springs and counterbalances as a series in the position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from dynident.models.equation import Equation
from dynident.models.friction.joint_term import Constant, JointTerm
from dynident.models.friction.ripple import WAVES
from dynident.models.term import Joint
from dynident.smoothers import BY_JOINT

__all__ = ["Spring"]

Array = NDArray[np.float64]
HIGHEST = 3
Order = Annotated[int, Ge(1), Le(HIGHEST)]


@dataclass(frozen=True)
class Spring(JointTerm):
    """Torque of a spring as a series in the position, for springs, cables and counterbalances of unknown geometry.

    Of a joint that turns, tau_j = sum of a_jk sin(k q_j) + b_jk cos(k q_j) for k = 1 to ``order``, in N m; of one that
    slides, tau_j = sum of c_jk q_j^k, in N/m^k. ``order`` is 1, 2 or 3, of all joints or by joint; other fields as in
    ``Viscous``. The constant of the series is ``Offset``. Where gravity acts on the joint, the data may not tell some
    parameters from those of the bodies.

    >>> import dynident as dy
    >>> [one.name for one in dy.models.Spring((dy.Joint("shoulder"),)).parameters]
    ['spring_shoulder_sin1', 'spring_shoulder_cos1']
    """

    constants: ClassVar[Mapping[str, Constant]] = {"order": Constant("1, 2 or 3", 1, HIGHEST, whole=True)}
    order: Annotated[Order | Mapping[str, Order], BY_JOINT] = 1

    def count(self, joint: Joint) -> int:
        """Return the number of parameters of a joint."""
        return len(_terms(joint, self.constant("order", joint.name)))

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameters of a joint."""
        for wave, k, _ in _terms(joint, self.constant("order", joint.name)):
            turn = wave != "q"
            unit = joint.effort if turn else "N/m" if k == 1 else f"N/m^{k}"
            shape = f"{wave}({k} q)".replace("(1 ", "(") if turn else f"q^{k}".removesuffix("^1")
            yield f"spring_{joint.name}_{wave}{k}", unit, f"spring: torque per {shape}"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        letters = {"sin": "a", "cos": "b", "q": "c"}
        terms = _terms(joint, self.constant("order", joint.name))
        symbols = tuple(f"{letters[wave]}_{k}" for wave, k, _ in terms)
        shapes = ((f"{wave}({k} * q)" if wave != "q" else f"q**{k}", k) for wave, k, _ in terms)
        plain = (shape.replace("1 * ", "").removesuffix("**1") if k == 1 else shape for shape, k in shapes)
        return Equation(" + ".join(f"{s} * {f}" for s, f in zip(symbols, plain, strict=True)), symbols)

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:  # noqa: ARG002
        """Return the torque per unit of each parameter (N, p)."""
        slides, k, phase = self._series
        return np.where(slides, q**k, np.sin(k * q + phase))

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> tuple[Array, None, None]:  # noqa: ARG002
        """Return the derivative of ``shapes`` by q, (N, p)."""
        slides, k, phase = self._series
        return k * np.where(slides, q ** (k - 1), np.cos(k * q + phase)), None, None

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source."""
        slides, k, phase = (f"np.array({one.tolist()!r})" for one in self._series)
        return f"np.where({slides}, q ** {k}, np.sin({k} * q + {phase}))"

    @cached_property
    def _series(self) -> tuple[NDArray[np.bool_], Array, Array]:
        """Whether it is a power, its exponent or the factor of the position, and the phase, each (p)."""
        joints = {joint.name: joint for joint in self.joints}
        found = [one for name in self.acts_on for one in _terms(joints[name], self.constant("order", name))]
        slides, k, phase = zip(*((wave == "q", float(k), phase) for wave, k, phase in found), strict=True)
        return np.array(slides), np.array(k), np.array(phase)


def _terms(joint: Joint, order: int) -> list[tuple[str, int, float]]:
    """Return the terms of the series of a joint: sin, cos or q, the factor or exponent, the phase."""
    waves = WAVES if joint.kind == "revolute" else (("q", 0.0),)
    return [(wave, k, phase) for k in range(1, int(order) + 1) for wave, phase in waves]
