"""Coulomb friction, by the sign of the velocity or a smooth one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.models.friction.per_joint import PerJoint

__all__ = ["Coulomb"]

SLOWEST = 1e-300  # rad/s, m/s: a velocity is divided by it

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Coulomb(PerJoint):
    """Coulomb friction, tau_j = Fc_j sign(dq_j), in N m or N; ``on``, ``names``, ... as in ``Viscous``.

    The sign can be changed in one of two ways, both in rad/s or m/s: ``width`` > 0 makes it tanh(dq / width), which
    a simulation needs; ``dead_band`` > 0 makes it 0 for abs(dq) <= dead_band, which leaves uncertain signs out of
    a fit. With neither, sign(0) = 0. The discontinuous sign has derivative 0 in ``partials``, also at the jump.
    Raises ModelError where both are given or one is negative or not finite, and as ``Viscous`` does.

    >>> import dynident as dy
    >>> dy.Coulomb((dy.Joint("shoulder"), dy.Joint("elbow")), on=("elbow",), width=0.01)
    Coulomb(on=('elbow',), names=None, expressions=None, values=None, width=0.01, dead_band=0.0)
    """

    width: Annotated[float, Ge(0)] = 0.0
    dead_band: Annotated[float, Ge(0)] = 0.0
    symbol = "Fc"
    role = "coulomb"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("width", "dead_band"):
            value = getattr(self, name)
            if not (value == 0 or SLOWEST <= value < np.inf):
                raise ModelError(f"Coulomb: {name} is {value}; give a velocity of 0 or more, in rad/s or m/s.")
        if self.width and self.dead_band:
            raise ModelError(
                f"Coulomb: width {self.width} and dead_band {self.dead_band} exclude each other; set one to 0."
            )

    @property
    def discontinuous(self) -> bool:
        """Whether the torque jumps with the sign of the velocity: no width and no dead band."""
        return not (self.width or self.dead_band)

    def with_smooth_sign(self, width: Array) -> tuple[SmoothCoulomb]:
        """Return the friction with tanh(dq / width) in place of the sign, each joint with its own width (n)."""
        names = tuple(parameter.name for parameter in self.parameters)
        widths = tuple(float(width[j]) for j in self._columns)
        return (SmoothCoulomb(self.joints, self.on, names, None, self.values, widths),)

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        if self.width:
            return f"Coulomb friction: torque per tanh(dq/{self.width:g})"
        band = f", 0 within abs(dq) <= {self.dead_band:g}" if self.dead_band else ""
        return f"Coulomb friction: torque per sign(dq){band}"

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        if self.width:
            return np.tanh(dq / self.width)
        return np.where(np.abs(dq) > self.dead_band, np.sign(dq), 0.0)

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        if not self.width:
            return np.zeros_like(dq)
        slope: Array = (1 - np.tanh(dq / self.width) ** 2) / self.width
        return slope


@dataclass(frozen=True)
class SmoothCoulomb(PerJoint):
    """Coulomb friction with a ``width`` (rad/s, m/s) for each joint in ``on``: tau_j = Fc_j tanh(dq_j / width_j)."""

    width: tuple[float, ...] = ()
    symbol = "Fc"
    role = "coulomb"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return "Coulomb friction: torque per tanh(dq / width)"

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return np.tanh(dq / self.width)

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        return np.asarray((1 - np.tanh(dq / self.width) ** 2) / self.width)
