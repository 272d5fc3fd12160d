"""A counterbalance: a linear spring between two points on both sides of a joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.models.equation import Equation
from dynident.models.friction.joint_term import Constant, Number
from dynident.models.friction.per_joint import PerJoint
from dynident.models.term import Joint
from dynident.smoothers import BY_JOINT

__all__ = ["Counterbalance"]

Array = NDArray[np.float64]
Length = Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT]
OrNone = Annotated[Annotated[float, Ge(0)] | Mapping[str, Annotated[float, Ge(0)]], BY_JOINT]
LENGTH = Constant("a length from 1e-6 to 1e3 m", 1e-6, 1e3)
SHORTEST = 1e-9  # m: a length is divided by it


@dataclass(frozen=True)
class Counterbalance(PerJoint):
    """A spring between two points on both sides of a joint that turns, with stiffness k_j in N/m.

    One point is ``base_arm`` (m) from the axis on the link before the joint, the other ``link_arm`` (m) on the link
    after it; at q = 0 the second arm is turned by ``angle`` (rad) from the first, about the axis. With the length
    L(q) = sqrt(a^2 + b^2 - 2 a b cos(q + angle)) and the ``free_length`` L0 (m), the potential k (L - L0)^2 / 2 gives
    tau_j = k_j (L - L0) dL/dq, which the drive has to hold. Lengths and angle are those of all joints or by joint;
    other fields as in ``Viscous``. Raises ModelError for a joint that slides, and as ``Viscous`` does.

    >>> import dynident as dy
    >>> joints = dy.Joint("base"), dy.Joint("shoulder")
    >>> shape = {"base_arm": 0.5, "link_arm": 0.2, "angle": 3.14, "free_length": 0.4}
    >>> spring = dy.models.Counterbalance(joints, on=("shoulder",), **shape)
    >>> spring.parameters[0].name, spring.parameters[0].unit
    ('kc_shoulder', 'N/m')
    """

    constants: ClassVar[Mapping[str, Constant]] = {
        "base_arm": LENGTH,
        "link_arm": LENGTH,
        "angle": Constant("an angle from -10 to 10 rad", -10.0, 10.0),
        "free_length": Constant("a length from 0 to 1e3 m", 0.0, 1e3),
    }
    base_arm: Length = field(kw_only=True)
    link_arm: Length = field(kw_only=True)
    angle: Number = field(kw_only=True)
    free_length: OrNone = field(kw_only=True)
    symbol = "kc"
    of = "q"

    def __post_init__(self) -> None:
        super().__post_init__()
        for joint in self.joints:
            if joint.name in self.acts_on and joint.kind == "prismatic":
                raise ModelError(
                    f"Counterbalance: joint {joint.name!r} slides; name those that turn by `on`, or use Spring."
                )

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return (
            f"counterbalance: stiffness of a spring of {self.free_length:g} m between arms of {self.base_arm:g} and "
            f"{self.link_arm:g} m, {self.angle:g} rad apart at q = 0"
        )

    def unit(self, joint: Joint) -> str:  # noqa: ARG002
        """Return the unit of a joint's parameter."""
        return "N/m"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        names = {"a": "base_arm", "b": "link_arm", "phi_0": "angle", "L_0": "free_length"}
        constants = (
            (key, self.constant(name, joint.name), "rad" if key == "phi_0" else "m") for key, name in names.items()
        )
        length = "L", "sqrt(a**2 + b**2 - 2 * a * b * cos(q + phi_0))"
        return Equation("k_c * (1 - L_0 / L) * a * b * sin(q + phi_0)", ("k_c",), tuple(constants), (length,))

    def shape(self, q: Array) -> Array:
        """Return the torque per unit of the parameter."""
        length, rate, _ = self._length(q)
        return np.asarray((length - self.by_column("free_length")) * rate)

    def slope(self, q: Array) -> Array:
        """Return the derivative of ``shape``."""
        length, rate, curvature = self._length(q)
        return np.asarray(rate**2 + (length - self.by_column("free_length")) * curvature)

    def _length(self, q: Array) -> tuple[Array, Array, Array]:
        """Return the length of the spring and its first and second derivative by q, each (N, p)."""
        a, b = self.by_column("base_arm"), self.by_column("link_arm")
        angle = q + self.by_column("angle")
        length = np.maximum(np.hypot(a - b, 2 * np.sqrt(a * b) * np.sin(angle / 2)), SHORTEST)
        rate = a * b * np.sin(angle) / length
        return length, rate, (a * b * np.cos(angle) - rate**2) / length

    def formula(self) -> str:
        """Return ``shape`` as NumPy source."""
        a, b, angle, free = map(self.source, ("base_arm", "link_arm", "angle", "free_length"))
        length = f"np.maximum(np.hypot({a} - {b}, 2 * np.sqrt({a} * {b}) * np.sin((q + {angle}) / 2)), {SHORTEST})"
        return f"(1 - {free} / {length}) * {a} * {b} * np.sin(q + {angle})"
