"""Ripple: torque that repeats with the position of a joint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.models.equation import Equation
from dynident.models.friction.joint_term import Constant, JointTerm, Number
from dynident.models.term import Joint
from dynident.smoothers import BY_JOINT

__all__ = ["Ripple"]

Array = NDArray[np.float64]
Cycles = Annotated[float, Gt(0)]
Several = Cycles | tuple[Cycles, ...]
WAVES = (("sin", 0.0), ("cos", np.pi / 2))  # as the sine of an angle and a phase


@dataclass(frozen=True)
class Ripple(JointTerm):
    """Torque that repeats with the position, tau_j = sum of a_jk sin(k u_j) + b_jk cos(k u_j), in N m or N.

    u = q - ``delay`` dq, and k are the ``cycles``, one or several: of a joint that turns, the number of periods in a
    turn, as of the teeth of its gear or the poles of its motor (Garcia et al. 2002, "Velocity dependence in the cyclic
    friction arising with gears"); of one that slides 2 pi / period, in rad/m. ``delay`` (s, within 1) is how much later
    than the position the torque acts, to first order in time, because a second one would be an inertia. Both are those
    of all joints, or by joint; other fields as in ``Viscous``. Raises ModelError for cycles that are listed twice, and
    as ``Viscous`` does.

    >>> import dynident as dy
    >>> ripple = dy.models.Ripple((dy.Joint("shoulder"), dy.Joint("elbow")), on=("elbow",), cycles=(100, 200))
    >>> [one.name for one in ripple.parameters]
    ['ripple_elbow_sin100', 'ripple_elbow_cos100', 'ripple_elbow_sin200', 'ripple_elbow_cos200']
    """

    constants: ClassVar[Mapping[str, Constant]] = {
        "cycles": Constant("numbers from 1e-3 to 1e6 in 1/rad or rad/m", 1e-3, 1e6),
        "delay": Constant("a time from -1 to 1 s", -1.0, 1.0),
    }
    cycles: Annotated[Several | Mapping[str, Several], BY_JOINT] = field(kw_only=True)
    delay: Number = 0.0
    symbol: ClassVar[str] = "ripple"
    letters: ClassVar[tuple[str, str, str]] = ("A", "B", "n")  # in an equation: of sine and cosine, and the cycles

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.acts_on:
            named = [f"{k:g}" for k in self._rates(name)]
            if twice := [k for i, k in enumerate(named) if k in named[:i]]:
                raise ModelError(
                    f"{type(self).__name__}: cycles of joint {name!r} list {twice[0]} twice; leave one out."
                )

    def count(self, joint: Joint) -> int:
        """Return the number of parameters of a joint."""
        return 2 * len(self._rates(joint.name))

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameters of a joint."""
        delay = self.constant("delay", joint.name)
        at = f"(q - {delay:g} dq)" if delay else "q"
        for k, (wave, _) in product(self._rates(joint.name), WAVES):
            yield f"{self.symbol}_{joint.name}_{wave}{k:g}", joint.effort, f"ripple: torque per {wave}({k:g} {at})"

    def law(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        delay, at = self.constant("delay", joint.name), "q"
        constants, symbols, parts = [], [], []
        if delay:
            constants, at = [("delta", delay, "s")], "(q - delta * dq)"
        sine, cosine, rate = self.letters
        for k, cycles in enumerate(self._rates(joint.name), 1):
            constants.append((f"{rate}_{k}", cycles, "1" if joint.kind == "revolute" else "rad/m"))
            symbols += [f"{sine}_{k}", f"{cosine}_{k}"]
            parts += [f"{sine}_{k} * sin({rate}_{k} * {at})", f"{cosine}_{k} * cos({rate}_{k} * {at})"]
        return Equation(" + ".join(parts), tuple(symbols), tuple(constants))

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:  # noqa: ARG002
        """Return the torque per unit of each parameter (N, p)."""
        return np.asarray(np.sin(self._angles(q, dq)))

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> tuple[Array, Array, None]:  # noqa: ARG002
        """Return the derivatives of ``shapes`` by q and dq, each (N, p)."""
        slope = self._waves[0] * np.cos(self._angles(q, dq))
        return slope, -self.by_column("delay") * slope, None

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source."""
        k, phase = (f"np.array({one!r})" for one in self._waves.tolist())
        return f"np.sin({k} * (q - {self.source('delay')} * dq) + {phase})"

    def _rates(self, joint: str) -> tuple[float, ...]:
        given = self.constant("cycles", joint)
        return given if isinstance(given, tuple) else (given,)

    @cached_property
    def _waves(self) -> Array:
        """The factors of the position and the phases, (2, p)."""
        found = [(k, phase) for name in self.acts_on for k, (_, phase) in product(self._rates(name), WAVES)]
        return np.array(found, dtype=float).T

    def _angles(self, q: Array, dq: Array) -> Array:
        k, phase = self._waves
        return np.asarray(k * (q - self.by_column("delay") * dq) + phase)
