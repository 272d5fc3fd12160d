"""The base of terms whose parameters each act on one joint, by that joint's motion alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from dynident.errors import ModelError, choices
from dynident.models.equation import Equation
from dynident.models.term import Joint, Parameter, Partials, declares
from dynident.smoothers import BY_JOINT

__all__ = ["FASTEST", "SLOWEST", "Constant", "JointTerm", "Number", "Slopes", "Speed"]

SLOWEST, FASTEST = 1e-9, 1e9  # rad/s, m/s: of shape constants
Number = Annotated[float | Mapping[str, float], BY_JOINT]
Speed = Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT]

Array = NDArray[np.float64]
Slopes = tuple[Array | None, Array | None, Array | None]  # by q, dq, ddq; None: zero


@dataclass(frozen=True)
class Constant:
    """The limits of a shape constant: from ``low`` to ``high``, or also 0 with ``zero``; ``words`` say it in errors."""

    words: str = "a velocity above 0, in rad/s or m/s"
    low: float = SLOWEST
    high: float = FASTEST
    zero: bool = False
    whole: bool = False

    def holds(self, value: object) -> bool:
        """Return whether a value is a number within the limits."""
        if not isinstance(value, Real):
            return False
        number = float(value)
        within = self.low <= number <= self.high or (self.zero and number == 0)
        return within and not (self.whole and number % 1)


@dataclass(frozen=True)
class JointTerm(ABC):
    """Base of terms with one or several parameters for each joint in ``on``: tau_j = sum of theta_jk f_jk.

    f_jk is a function of q_j, dq_j and ddq_j. A subclass defines ``described``, its parameters, and ``shapes`` and
    ``slopes``, its columns; ``count`` where a joint has several, ``formula`` for exports. ``constants`` names those of
    its fields that are constants of the shape: one for all joints, or a mapping by joint. ``role`` is that of
    ``Parameter``. Methods pass on the memory of a term that has one.
    """

    role: ClassVar[str] = ""
    constants: ClassVar[Mapping[str, Constant]] = {}
    joints: tuple[Joint, ...] = field(repr=False)
    on: tuple[str, ...] | None = None
    names: tuple[str, ...] | None = None
    expressions: tuple[str, ...] | None = None
    values: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("joints", "on", "names", "expressions", "values"):
            given = getattr(self, name)
            object.__setattr__(self, name, None if given is None else tuple(given))
        self._check_on()
        for name, allowed in self.constants.items():
            object.__setattr__(self, name, self._checked(name, getattr(self, name), allowed))
        count, on = len(self._columns), self.acts_on
        what = "joints" if count == len(on) else "parameters of joints"
        for name in ("names", "expressions", "values"):
            given = getattr(self, name)
            if given is not None and len(given) != count:
                raise ModelError(f"{type(self).__name__}: {len(given)} {name} for {count} {what} ({', '.join(on)}).")

    def _check_on(self) -> None:
        known = [joint.name for joint in self.joints]
        if not self.acts_on:
            raise ModelError(f"{type(self).__name__}: 'on' names no joint; name one of {', '.join(known)}.")
        for k, name in enumerate(self.acts_on):
            if name not in known:
                raise ModelError(f"{type(self).__name__}: no joint {name!r}; {choices(name, known)}")
            if name in self.acts_on[:k]:
                raise ModelError(f"{type(self).__name__}: joint {name!r} is listed twice in 'on'.")

    def _checked(self, name: str, given: Any, allowed: Constant) -> Any:
        """Return a shape constant, that of each joint as pairs in the order of ``on``; ModelError for a wrong one."""
        where = f"{type(self).__name__}: {name}"
        if not _is_by_joint(given):
            return _several(given, where, allowed)
        pairs = dict(given)
        for joint in pairs:
            if joint not in self.acts_on:
                raise ModelError(f"{where} is given for {joint!r}; {choices(joint, self.acts_on)}")
        for joint in self.acts_on:
            if joint not in pairs:
                raise ModelError(f"{where} lacks joint {joint!r}; give it for {', '.join(self.acts_on)}.")
        return tuple((one, _several(pairs[one], f"{where} of joint {one!r}", allowed)) for one in self.acts_on)

    @property
    def acts_on(self) -> tuple[str, ...]:
        """The joints that the term acts on: ``on``, or all."""
        return tuple(joint.name for joint in self.joints) if self.on is None else self.on

    def constant(self, name: str, joint: str) -> Any:
        """Return a shape constant at a joint."""
        value = getattr(self, name)
        return dict(value)[joint] if _is_by_joint(value) else value

    def by_column(self, name: str) -> Array:
        """Return a shape constant (p), a single number for each joint, at the joint of each parameter."""
        if name not in self._known:
            self._known[name] = np.array([self.constant(name, self.joints[j].name) for j in self._columns], dtype=float)
        return self._known[name]

    @cached_property
    def _known(self) -> dict[str, Array]:
        """What ``by_column`` has found."""
        return {}

    def alone(self, joint: str) -> Self:
        """Return the term on one of its joints alone, with the default names of its parameters."""
        own = {name: self.constant(name, joint) for name in self.constants}
        return replace(self, on=(joint,), names=None, expressions=None, values=None, **own)

    @cached_property
    def _columns(self) -> list[int]:
        """Index of the joint that each parameter acts on."""
        place = {joint.name: j for j, joint in enumerate(self.joints)}
        return [place[name] for name in self.acts_on for _ in range(self.count(self.joints[place[name]]))]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of each joint in ``on``, in that order."""
        kinds = {joint.name: joint for joint in self.joints}
        found = [one for name in self.acts_on for one in self.alone(name).described(kinds[name])]
        names, units, expressions = ([one[k] for one in found] for k in range(3))
        values = self.values or (None,) * len(found)
        roles = (self.role,) * len(found)
        return tuple(map(Parameter, self.names or names, units, self.expressions or expressions, values, roles))

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, p): each parameter acts on one joint."""
        return np.asarray(np.arange(len(self.joints))[:, None] == np.array(self._columns, dtype=int))

    def entries(
        self, q: Array, dq: Array, ddq: Array, joint: NDArray[np.intp], parameter: NDArray[np.intp], *memory: Array
    ) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows m, shape (M, N)."""
        shapes = self._own(q, dq, ddq, *memory).T
        return shapes[parameter] * self.support[joint, parameter][:, None]

    def regressor(self, q: Array, dq: Array, ddq: Array, *memory: Array) -> Array:
        """Return Y, shape (N, n, p), for q, dq and ddq (N, n) in rad or m and seconds."""
        joints = self._columns
        out = np.zeros((*q.shape, len(joints)))
        out[:, joints, range(len(joints))] = self._own(q, dq, ddq, *memory)
        return out

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array, *memory: Array) -> Array:
        """Return Y theta, shape (N, n), for one theta (p)."""
        return self._summed(self._own(q, dq, ddq, *memory) * theta)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array, *memory: Array) -> Partials:
        """Return the derivatives of Y theta by q, dq and ddq, each (N, n, n)."""
        joints, every = self._columns, range(q.shape[1])
        zero, found = np.zeros((*q.shape, q.shape[1])), []
        for slope in self.slopes(q[:, joints], dq[:, joints], ddq[:, joints], *memory):
            if slope is not None:
                whole = np.zeros(zero.shape)
                whole[:, every, every] = self._summed(slope * theta)
            found.append(zero if slope is None else whole)
        return Partials(*found)

    def weighted_gradient(self, q: Array, dq: Array, ddq: Array, weights: Array, *memory: Array) -> Array:
        """Return the derivatives (3, N, n) by q, dq and ddq of the sums <G_i, Y_i> for weights G (N, n, p)."""
        joints, out = self._columns, np.zeros((3, *q.shape))
        own = weights[:, joints, range(len(joints))]
        for found, slope in zip(out, self.slopes(q[:, joints], dq[:, joints], ddq[:, joints], *memory), strict=True):
            if slope is not None:
                found[:] = self._summed(slope * own)
        return out

    def _own(self, q: Array, dq: Array, ddq: Array, *memory: Array) -> Array:
        joints = self._columns
        return self.shapes(q[:, joints], dq[:, joints], ddq[:, joints], *memory)

    def _summed(self, x: Array) -> Array:
        """Return the sums (N, n) by joint of x (N, p)."""
        return np.asarray(x @ self._places)

    @cached_property
    def _places(self) -> Array:
        """One for each parameter (p) at its joint (n)."""
        return np.eye(len(self.joints))[self._columns]

    @property
    def equations(self) -> tuple[Equation, ...]:
        """The equation of each joint in ``on`` by ``law``; none where a subclass has another shape and no law of it."""
        known = {joint.name: joint for joint in self.joints}
        if not all(declares(self, "law", of) for of in ("regressor", "shapes", "shape", "sign") if hasattr(self, of)):
            return ()
        found, start = [], 0
        for name in self.acts_on:
            law = self.law(known[name])
            if law is None:
                return ()
            own = self.parameters[start : start + len(law.symbols)]
            start += len(law.symbols)
            found.append(replace(law, parameters=tuple(one.name for one in own), on=((name, 1.0),)))
        return tuple(found)

    def law(self, joint: Joint) -> Equation | None:  # noqa: ARG002
        """Return the torque at a joint as an equation, without its ``parameters`` and ``on``; None: not known."""
        return None

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source, of q, dq and ddq; empty where it is not known."""
        return ""

    def source(self, name: str) -> str:
        """Return a shape constant as NumPy source, for ``formula``."""
        numbers = self.by_column(name).tolist()
        return repr(numbers[0]) if len(set(numbers)) == 1 else f"np.array({numbers!r})"

    def numpy_source(self, name: str, theta: Array) -> str:
        """Return the text of a function of q, dq and ddq that gives Y theta; ModelError without a ``formula``."""
        if not (formula := self.formula()):
            cls = type(self).__name__
            raise ModelError(f"model.py cannot hold the term {cls}: give its formula by a method `{cls}.formula`.")
        return (
            f"def {name}(q, dq, ddq):\n"
            f"    joints = {self._columns!r}\n"
            f"    q, dq, ddq = q[:, joints], dq[:, joints], ddq[:, joints]\n"
            f"    return (np.array({theta.tolist()!r}) * ({formula})) @ np.eye({len(self.joints)})[joints]\n"
        )

    def count(self, joint: Joint) -> int:  # noqa: ARG002
        """Return the number of parameters of a joint."""
        return 1

    @abstractmethod
    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameters of a joint, which is the only one in ``on``."""

    @abstractmethod
    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:
        """Return the torque per unit of each parameter (N, p), for the motion (N, p) of its joint."""

    @abstractmethod
    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Slopes:
        """Return the derivatives of ``shapes`` by q, dq and ddq, each (N, p), or None for zero."""


def _is_by_joint(value: object) -> bool:
    """Whether a constant is given by joint: as a mapping, or as the pairs that stand for one."""
    return isinstance(value, Mapping) or (isinstance(value, tuple) and bool(value) and isinstance(value[0], tuple))


def _several(given: Any, where: str, allowed: Constant) -> Any:
    """Return a number, or several as a tuple, once they are within the limits."""
    numbers = tuple(given) if isinstance(given, list | tuple) else (given,)
    if not numbers:
        raise ModelError(f"{where} is empty; give {allowed.words}.")
    for number in numbers:
        if not allowed.holds(number):
            raise ModelError(f"{where} is {number}; give {allowed.words}.")
    return numbers if isinstance(given, list | tuple) else given
