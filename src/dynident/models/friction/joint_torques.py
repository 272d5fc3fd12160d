"""Springs and counterbalances as a series in the position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Le

from dynident.models.friction.joint_term import CONSTANT_LAW, Constant, JointTerm, Number, PerJoint
from dynident.models.term import Equation, Joint, Past
from dynident.motion.smoothers import BY_JOINT
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array


@dataclass(frozen=True)
class Offset(PerJoint):
    """Constant torque of a joint, tau_j = offset_j, in N m or N; ``on``, ``names``, ... as in ``Viscous``.

    >>> import dynident as dy
    >>> dy.Offset((dy.Joint("elbow"),)).parameters[0].name
    'offset_elbow'
    """

    title: ClassVar[str] = "constant torque"

    symbol, letter = "offset", "tau_o"
    law = CONSTANT_LAW
    words = "constant torque"


Time = Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT]


@dataclass(frozen=True)
class Drift(PerJoint):
    """Drift of a torque, tau_j = drift_j (1 - exp(-t / T_j)), in N m or N, with t (s) from the start of the recording.

    ``time`` T (s) is that in which most of the drift is over, of all joints or by joint; ``on``, ``names``, ... as in
    ``Viscous``. Every recording starts cold: this suits those that were made after the same pause.

    >>> import dynident as dy
    >>> from dynident.models.friction import Drift
    >>> Drift((dy.Joint("elbow"),), time=120.0).parameters[0].expression
    'torque by which the joint drifts, in about 120 s'
    """

    title: ClassVar[str] = "drift"

    constants: ClassVar[Mapping[str, Constant]] = {"time": Constant("a time above 0, in s")}
    time: Time = 60.0
    states: ClassVar[tuple[str, ...]] = ("z",)
    symbol = "drift"
    law = "z"
    words = "torque by which the joint drifts, in about {time:g} s"

    def remember_state(self, past: Past) -> Array:
        """Return the share of the drift that is over at the samples of a motion, shape (N, p)."""
        start = 0.0 if past.start is None else past.start
        elapsed = (past.t - past.t[:1])[:, None]
        return np.asarray(1.0 - (1.0 - start) * np.exp(-elapsed / self.by_column("time")))

    def equation(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        time = "T", self.constant("time", joint.name), "s"
        return Equation("D * (1 - exp(-t / T))", ("D",), (time,))


Length = Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT]
LengthOrZero = Annotated[Annotated[float, Ge(0)] | Mapping[str, Annotated[float, Ge(0)]], BY_JOINT]
LENGTH = Constant("a length from 1e-6 to 1e3 m", 1e-6, 1e3)
MIN_LENGTH = 1e-9  # m: a length is divided by it


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
    >>> spring = dy.models.friction.Counterbalance(joints, on=("shoulder",), **shape)
    >>> spring.parameters[0].name, spring.parameters[0].unit
    ('kc_shoulder', 'N/m')
    """

    title: ClassVar[str] = "counterbalance"

    constants: ClassVar[Mapping[str, Constant]] = {
        "base_arm": LENGTH,
        "link_arm": LENGTH,
        "angle": Constant("an angle from -10 to 10 rad", -10.0, 10.0),
        "free_length": Constant("a length from 0 to 1e3 m", 0.0, 1e3),
    }
    base_arm: Length = field(kw_only=True)
    link_arm: Length = field(kw_only=True)
    angle: Number = field(kw_only=True)
    free_length: LengthOrZero = field(kw_only=True)
    symbol = "kc"
    # the law of cosines by the half angle, which keeps its digits where the arms are in line
    length: ClassVar[str] = (
        f"maximum(sqrt((base_arm - link_arm)**2 + 4 * base_arm * link_arm * sin((q + angle) / 2)**2), {MIN_LENGTH})"
    )
    law = f"(1 - free_length / {length}) * base_arm * link_arm * sin(q + angle)"
    words = (
        "counterbalance: stiffness of a spring of {free_length:g} m between arms of {base_arm:g} and {link_arm:g} m, "
        "{angle:g} rad apart at q = 0"
    )
    unit_text = "N/m"

    def __post_init__(self) -> None:
        super().__post_init__()
        for joint in self.joints:
            if joint.name in self.acts_on and joint.kind == "prismatic":
                raise ModelError(
                    f"Counterbalance: joint {joint.name!r} slides; name those that turn by `on`, or use Spring."
                )

    def equation(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        names = {"a": "base_arm", "b": "link_arm", "phi_0": "angle", "L_0": "free_length"}
        constants = (
            (key, self.constant(name, joint.name), "rad" if key == "phi_0" else "m") for key, name in names.items()
        )
        length = "L", "sqrt(a**2 + b**2 - 2 * a * b * cos(q + phi_0))"
        return Equation("k_c * (1 - L_0 / L) * a * b * sin(q + phi_0)", ("k_c",), tuple(constants), (length,))


Cycles = Annotated[float, Gt(0)]
CyclesList = Cycles | tuple[Cycles, ...]
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
    >>> ripple = dy.models.friction.Ripple((dy.Joint("shoulder"), dy.Joint("elbow")), on=("elbow",), cycles=(100, 200))
    >>> [parameter.name for parameter in ripple.parameters]
    ['ripple_elbow_sin100', 'ripple_elbow_cos100', 'ripple_elbow_sin200', 'ripple_elbow_cos200']
    """

    title: ClassVar[str] = "ripple over the position"

    constants: ClassVar[Mapping[str, Constant]] = {
        "cycles": Constant("numbers from 1e-3 to 1e6 in 1/rad or rad/m", 1e-3, 1e6),
        "delay": Constant("a time from -1 to 1 s", -1.0, 1.0),
    }
    cycles: Annotated[CyclesList | Mapping[str, CyclesList], BY_JOINT] = field(kw_only=True)
    delay: Number = 0.0
    law = "sin(rate * (q - delay * dq) + phase)"
    symbol: ClassVar[str] = "ripple"
    letters: ClassVar[tuple[str, str, str]] = ("A", "B", "n")  # in an equation: of sine and cosine, and the cycles

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.acts_on:
            labels = [f"{k:g}" for k in self._cycles_of(name)]
            if duplicates := [k for i, k in enumerate(labels) if k in labels[:i]]:
                raise ModelError(
                    f"{type(self).__name__}: cycles of joint {name!r} list {duplicates[0]} twice; leave one out."
                )

    def count(self, joint: Joint) -> int:
        """Return the number of parameters of a joint."""
        return 2 * len(self._cycles_of(joint.name))

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameters of a joint."""
        delay = self.constant("delay", joint.name)
        argument = f"(q - {delay:g} dq)" if delay else "q"
        for k, (wave, _) in product(self._cycles_of(joint.name), WAVES):
            yield (
                f"{self.symbol}_{joint.name}_{wave}{k:g}",
                joint.effort,
                f"ripple: torque per {wave}({k:g} {argument})",
            )

    def equation(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        delay, argument = self.constant("delay", joint.name), "q"
        constants, symbols, parts = [], [], []
        if delay:
            constants, argument = [("delta", delay, "s")], "(q - delta * dq)"
        sine, cosine, rate = self.letters
        for k, cycles in enumerate(self._cycles_of(joint.name), 1):
            constants.append((f"{rate}_{k}", cycles, "1" if joint.kind == "revolute" else "rad/m"))
            symbols += [f"{sine}_{k}", f"{cosine}_{k}"]
            parts += [f"{sine}_{k} * sin({rate}_{k} * {argument})", f"{cosine}_{k} * cos({rate}_{k} * {argument})"]
        return Equation(" + ".join(parts), tuple(symbols), tuple(constants))

    def _cycles_of(self, joint: str) -> tuple[float, ...]:
        cycles = self.constant("cycles", joint)
        return cycles if isinstance(cycles, tuple) else (cycles,)

    @cached_property
    def _constants_by_column(self) -> dict[str, Array]:
        """The factors of the position and the phases (p)."""
        waves = [(k, phase) for name in self.acts_on for k, (_, phase) in product(self._cycles_of(name), WAVES)]
        return dict(zip(("rate", "phase"), np.array(waves, dtype=float).T, strict=True))


MAX_ORDER = 3
Order = Annotated[int, Ge(1), Le(MAX_ORDER)]


@dataclass(frozen=True)
class Spring(JointTerm):
    """Torque of a spring as a series in the position, for springs, cables and counterbalances of unknown geometry.

    Of a joint that turns, tau_j = sum of a_jk sin(k q_j) + b_jk cos(k q_j) for k = 1 to ``order``, in N m; of one that
    slides, tau_j = sum of c_jk q_j^k, in N/m^k. ``order`` is 1, 2 or 3, of all joints or by joint; other fields as in
    ``Viscous``. The constant of the series is ``Offset``. Where gravity acts on the joint, the data may not tell some
    parameters from those of the bodies.

    >>> import dynident as dy
    >>> [parameter.name for parameter in dy.models.friction.Spring((dy.Joint("shoulder"),)).parameters]
    ['spring_shoulder_sin1', 'spring_shoulder_cos1']
    """

    title: ClassVar[str] = "spring"

    constants: ClassVar[Mapping[str, Constant]] = {"order": Constant("1, 2 or 3", 1, MAX_ORDER, integer=True)}
    order: Annotated[Order | Mapping[str, Order], BY_JOINT] = 1
    law = "where(slides, q**k, sin(k * q + phase))"

    def count(self, joint: Joint) -> int:
        """Return the number of parameters of a joint."""
        return len(_terms(joint, self.constant("order", joint.name)))

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameters of a joint."""
        for wave, k, _ in _terms(joint, self.constant("order", joint.name)):
            is_angle = wave != "q"
            unit = joint.effort if is_angle else "N/m" if k == 1 else f"N/m^{k}"
            shape = f"{wave}({k} q)".replace("(1 ", "(") if is_angle else f"q^{k}".removesuffix("^1")
            yield f"spring_{joint.name}_{wave}{k}", unit, f"spring: torque per {shape}"

    def equation(self, joint: Joint) -> Equation:
        """Return the torque at a joint as an equation."""
        letters = {"sin": "a", "cos": "b", "q": "c"}
        terms = _terms(joint, self.constant("order", joint.name))
        symbols = tuple(f"{letters[wave]}_{k}" for wave, k, _ in terms)
        # readers do not write a factor or an exponent of 1
        shapes = ((f"{wave}({k} * q)" if wave != "q" else f"q**{k}", k) for wave, k, _ in terms)
        readable = (shape.replace("1 * ", "").removesuffix("**1") if k == 1 else shape for shape, k in shapes)
        return Equation(" + ".join(f"{s} * {f}" for s, f in zip(symbols, readable, strict=True)), symbols)

    @cached_property
    def _constants_by_column(self) -> dict[str, Array]:
        """Whether each parameter (p) is of a power; exponent or factor of the position (p); phase (p)."""
        joints = {joint.name: joint for joint in self.joints}
        terms = [term for name in self.acts_on for term in _terms(joints[name], self.constant("order", name))]
        slides, k, phase = zip(*((wave == "q", float(k), phase) for wave, k, phase in terms), strict=True)
        return {"slides": np.array(slides), "k": np.array(k), "phase": np.array(phase)}


def _terms(joint: Joint, order: int) -> list[tuple[str, int, float]]:
    """Return the terms of the series of a joint, each as sin, cos or q, its factor or exponent, and its phase."""
    waves = WAVES if joint.kind == "revolute" else (("q", 0.0),)
    return [(wave, k, phase) for k in range(1, int(order) + 1) for wave, phase in waves]
