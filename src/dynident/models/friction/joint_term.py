"""The base of terms whose parameters each act on one joint, by that joint's motion alone."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from dynident.models.term import Equation, Joint, Parameter, Partials, Term
from dynident.motion.smoothers import BY_JOINT
from dynident.runtime import ModelError, choices

MIN_VELOCITY, MAX_VELOCITY = 1e-9, 1e9  # rad/s, m/s: of shape constants
Number = Annotated[float | Mapping[str, float], BY_JOINT]
Speed = Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT]

Array = NDArray[np.float64]
Slopes = tuple[Array | None, Array | None, Array | None]  # by q, dq, ddq; None: zero


@dataclass(frozen=True)
class Constant:
    """The limits of a shape constant: from ``low`` to ``high``, or also 0 with ``zero``; ``words`` say it in errors."""

    words: str = "a velocity above 0, in rad/s or m/s"
    low: float = MIN_VELOCITY
    high: float = MAX_VELOCITY
    zero: bool = False
    integer: bool = False

    def accepts(self, value: object) -> bool:
        """Return whether a value is a number within the limits."""
        if not isinstance(value, Real):
            return False
        number = float(value)
        in_range = self.low <= number <= self.high or (self.zero and number == 0)
        return in_range and not (self.integer and number % 1)


@dataclass(frozen=True)
class JointTerm(Term):
    """Base of terms with one or several parameters for each joint in ``on``: tau_j = sum of theta_jk f_jk.

    f_jk is a function of q_j, dq_j and ddq_j. A subclass defines ``described``, its parameters, and ``shapes`` and
    ``slopes``, its columns; ``count`` where a joint has several, ``formula`` for exports. ``constants`` names those of
    its fields that are constants of the shape: one for all joints, or a mapping by joint. ``role`` is that of
    ``Parameter``. Methods pass on the memory of a term that has one.
    """

    FOLLOWS: ClassVar[Mapping[str, tuple[str, ...]]] = {**Term.FOLLOWS, "law": ("regressor", "shapes", "shape", "sign")}
    role: ClassVar[str] = ""
    constants: ClassVar[Mapping[str, Constant]] = {}
    joints: tuple[Joint, ...] = field(repr=False)
    on: tuple[str, ...] | None = None
    names: tuple[str, ...] | None = None
    expressions: tuple[str, ...] | None = None
    values: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("joints", "on", "names", "expressions", "values"):
            setting = getattr(self, name)
            object.__setattr__(self, name, None if setting is None else tuple(setting))
        self._check_on()
        for name, allowed in self.constants.items():
            object.__setattr__(self, name, self._check_constant(name, getattr(self, name), allowed))
        count, on = len(self._columns), self.acts_on
        owners = "joints" if count == len(on) else "parameters of joints"
        for name in ("names", "expressions", "values"):
            setting = getattr(self, name)
            if setting is not None and len(setting) != count:
                raise ModelError(
                    f"{type(self).__name__}: {len(setting)} {name} for {count} {owners} ({', '.join(on)})."
                )

    def _check_on(self) -> None:
        joint_names = [joint.name for joint in self.joints]
        if not self.acts_on:
            raise ModelError(f"{type(self).__name__}: 'on' names no joint; name one of {', '.join(joint_names)}.")
        for k, name in enumerate(self.acts_on):
            if name not in joint_names:
                raise ModelError(f"{type(self).__name__}: no joint {name!r}; {choices(name, joint_names)}")
            if name in self.acts_on[:k]:
                raise ModelError(f"{type(self).__name__}: joint {name!r} is listed twice in 'on'.")

    def _check_constant(self, name: str, constant: Any, allowed: Constant) -> Any:
        """Return a shape constant, one by joint as pairs in the order of ``on``; ModelError for a wrong one."""
        where = f"{type(self).__name__}: {name}"
        if not _is_by_joint(constant):
            return _check_numbers(constant, where, allowed)
        pairs = dict(constant)
        for joint in pairs:
            if joint not in self.acts_on:
                raise ModelError(f"{where} is given for {joint!r}; {choices(joint, self.acts_on)}")
        for joint in self.acts_on:
            if joint not in pairs:
                raise ModelError(f"{where} lacks joint {joint!r}; give it for {', '.join(self.acts_on)}.")
        return tuple(
            (joint_name, _check_numbers(pairs[joint_name], f"{where} of joint {joint_name!r}", allowed))
            for joint_name in self.acts_on
        )

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
        if name not in self._constants_by_column:
            self._constants_by_column[name] = np.array(
                [self.constant(name, self.joints[j].name) for j in self._columns], dtype=float
            )
        return self._constants_by_column[name]

    @cached_property
    def _constants_by_column(self) -> dict[str, Array]:
        """The constants that ``by_column`` has found so far, by name."""
        return {}

    def for_joint(self, joint: str) -> Self:
        """Return the term on one of its joints alone, with the default names of its parameters."""
        constants = {name: self.constant(name, joint) for name in self.constants}
        return replace(self, on=(joint,), names=None, expressions=None, values=None, **constants)

    @cached_property
    def _columns(self) -> list[int]:
        """Index of the joint that each parameter acts on."""
        place = {joint.name: j for j, joint in enumerate(self.joints)}
        return [place[name] for name in self.acts_on for _ in range(self.count(self.joints[place[name]]))]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of each joint in ``on``, in that order."""
        kinds = {joint.name: joint for joint in self.joints}
        descriptions = [
            description for name in self.acts_on for description in self.for_joint(name).described(kinds[name])
        ]
        names, units, expressions = ([description[k] for description in descriptions] for k in range(3))
        values = self.values or (None,) * len(descriptions)
        roles = (self.role,) * len(descriptions)
        return tuple(map(Parameter, self.names or names, units, self.expressions or expressions, values, roles))

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, p): each parameter acts on one joint."""
        return np.asarray(np.arange(len(self.joints))[:, None] == np.array(self._columns, dtype=int))

    def entries(
        self, q: Array, dq: Array, ddq: Array, joint: NDArray[np.intp], parameter: NDArray[np.intp], *memory: Array
    ) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows m, shape (M, N)."""
        shapes = self._joint_shapes(q, dq, ddq, *memory).T
        return shapes[parameter] * self.support[joint, parameter][:, None]

    def regressor(self, q: Array, dq: Array, ddq: Array, *memory: Array) -> Array:
        """Return Y, shape (N, n, p), for q, dq and ddq (N, n) in rad or m and seconds."""
        joints = self._columns
        out = np.zeros((*q.shape, len(joints)))
        out[:, joints, range(len(joints))] = self._joint_shapes(q, dq, ddq, *memory)
        return out

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array, *memory: Array) -> Array:
        """Return Y theta, shape (N, n), for one theta (p)."""
        return self._sum_by_joint(self._joint_shapes(q, dq, ddq, *memory) * theta)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array, *memory: Array) -> Partials:
        """Return the derivatives of Y theta by q, dq and ddq, each (N, n, n)."""
        joints, diagonal = self._columns, range(q.shape[1])
        zero, derivatives = np.zeros((*q.shape, q.shape[1])), []
        # a torque depends on its own joint only: the derivatives are diagonal
        for slope in self.slopes(q[:, joints], dq[:, joints], ddq[:, joints], *memory):
            if slope is not None:
                matrix = np.zeros(zero.shape)
                matrix[:, diagonal, diagonal] = self._sum_by_joint(slope * theta)
            derivatives.append(zero if slope is None else matrix)
        return Partials(*derivatives)

    def weighted_gradient(self, q: Array, dq: Array, ddq: Array, weights: Array, *memory: Array) -> Array:
        """Return the derivatives (3, N, n) by q, dq and ddq of the sums <G_i, Y_i> for weights G (N, n, p)."""
        joints, out = self._columns, np.zeros((3, *q.shape))
        joint_weights = weights[:, joints, range(len(joints))]
        for gradient, slope in zip(out, self.slopes(q[:, joints], dq[:, joints], ddq[:, joints], *memory), strict=True):
            if slope is not None:
                gradient[:] = self._sum_by_joint(slope * joint_weights)
        return out

    def _joint_shapes(self, q: Array, dq: Array, ddq: Array, *memory: Array) -> Array:
        joints = self._columns
        return self.shapes(q[:, joints], dq[:, joints], ddq[:, joints], *memory)

    def _sum_by_joint(self, x: Array) -> Array:
        """Return the sums (N, n) by joint of x (N, p)."""
        return np.asarray(x @ self._joint_selection)

    @cached_property
    def _joint_selection(self) -> Array:
        """Ones (p, n) at the joint of each parameter, zeros elsewhere."""
        return np.eye(len(self.joints))[self._columns]

    @property
    def equations(self) -> tuple[Equation, ...]:
        """The equation of each joint in ``on`` by ``law``; none where a subclass overrides the torque alone."""
        joints_by_name = {joint.name: joint for joint in self.joints}
        equations, start = [], 0
        for name in self.acts_on:
            law = self.law(joints_by_name[name])
            if law is None:
                return ()
            parameters = self.parameters[start : start + len(law.symbols)]
            start += len(law.symbols)
            equations.append(
                replace(law, parameters=tuple(parameter.name for parameter in parameters), on=((name, 1.0),))
            )
        return tuple(equations)

    def law(self, joint: Joint) -> Equation | None:  # noqa: ARG002
        """Return the torque at a joint as an equation, without its ``parameters`` and ``on``; None: not known."""
        return None

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source, of q, dq and ddq; empty where it is not known."""
        return ""

    def source(self, name: str) -> str:
        """Return a shape constant as NumPy source, for ``formula``."""
        numbers = self.by_column(name).tolist()
        # a single number where the constant is the same everywhere
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


def _check_numbers(constant: Any, where: str, allowed: Constant) -> Any:
    """Return a number, or several as a tuple; ModelError unless all are within the limits."""
    numbers = tuple(constant) if isinstance(constant, list | tuple) else (constant,)
    if not numbers:
        raise ModelError(f"{where} is empty; give {allowed.words}.")
    for number in numbers:
        if not allowed.accepts(number):
            raise ModelError(f"{where} is {number}; give {allowed.words}.")
    return numbers if isinstance(constant, list | tuple) else constant


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


@dataclass(frozen=True)
class Viscous(PerJoint):
    """Viscous friction, tau_j = Fv_j dq_j, in N m s/rad or N s/m (mu of the article's eqs. 39 and 40).

    It acts on the joints named in ``on`` (default: all of ``joints``). ``names``, ``expressions`` (meanings) and
    ``values`` (nominal), one for each joint in ``on``, replace the defaults, Fv_<joint> for the name. Raises ModelError
    for an unknown joint, or where the numbers of entries differ.

    >>> import dynident as dy
    >>> friction = dy.Viscous((dy.Joint("shoulder"), dy.Joint("rail", "prismatic")))
    >>> [(parameter.name, parameter.unit) for parameter in friction.parameters]
    [('Fv_shoulder', 'N m s/rad'), ('Fv_rail', 'N s/m')]
    """

    title: ClassVar[str] = "viscous friction"

    symbol = "Fv"
    role = "viscous"

    def meaning(self) -> str:
        """Return the meaning of the parameter."""
        return "viscous friction: torque per dq"

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return "N m s/rad" if joint.kind == "revolute" else "N s/m"

    def law(self, joint: Joint) -> Equation:  # noqa: ARG002
        """Return the torque at a joint as an equation."""
        return Equation("F_v * dq", ("F_v",))

    def shape(self, dq: Array) -> Array:
        """Return the torque per unit of the parameter."""
        return dq

    def slope(self, dq: Array) -> Array:
        """Return the derivative of ``shape``."""
        return np.ones_like(dq)
