"""The base of terms whose parameters each act on one joint, by that joint's motion alone."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from dynident.models.friction.law import LAW_FUNCTIONS, differentiate_law, evaluate_law, functions_in, names_in, rename
from dynident.models.term import FUNCTIONS, Equation, Joint, Parameter, Partials, Past, Term, check_joints
from dynident.motion.smoothers import BY_JOINT
from dynident.runtime import ModelError, choices
from dynident.runtime.arrays import Array

MIN_VELOCITY, MAX_VELOCITY = 1e-9, 1e9  # rad/s, m/s: of shape constants
Number = Annotated[float | Mapping[str, float], BY_JOINT]
Speed = Annotated[Annotated[float, Gt(0)] | Mapping[str, Annotated[float, Gt(0)]], BY_JOINT]

CONSTANT_LAW = "dq**0"  # one at any velocity

Slopes = tuple[Array | None, Array | None, Array | None]  # by q, dq, ddq; None: zero


@dataclass(frozen=True)
class Constant:
    """The limits of a shape constant: from ``low`` to ``high``, or also 0 with ``zero``; ``words`` say it in errors.

    In equations it has the ``letter``, by default its name, and the ``unit``, in which {unit} is that of the joint.
    """

    words: str = "a velocity above 0, in rad/s or m/s"
    low: float = MIN_VELOCITY
    high: float = MAX_VELOCITY
    zero: bool = False
    integer: bool = False
    letter: str = ""
    unit: str = "{unit}/s"

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

    f_jk is a function of q_j, dq_j and ddq_j, by default that of the text ``law``, from which its derivatives and its
    NumPy source follow. It may name what the term remembers, its ``states``: ``z``, and the ``load`` of the joint. A
    subclass whose torque is no such text defines ``shapes`` and ``slopes``, its columns, and ``formula`` for exports.
    Each defines ``described``, its parameters, and ``count`` where a joint has several.
    ``constants`` names those of its fields that are constants of the shape: one for all joints, or a mapping by joint.
    ``role`` is that of ``Parameter``. Methods pass on the memory of a term that has one.
    """

    FOLLOWS: ClassVar[Mapping[str, tuple[str, ...]]] = {**Term.FOLLOWS, "equation": ("regressor", "shapes")}
    law: ClassVar[str] = ""
    states: ClassVar[tuple[str, ...]] = ()
    role: ClassVar[str] = ""
    constants: ClassVar[Mapping[str, Constant]] = {}
    joints: tuple[Joint, ...] = field(repr=False)
    on: tuple[str, ...] | None = None
    names: tuple[str, ...] | None = None
    expressions: tuple[str, ...] | None = None
    values: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", check_joints(self, self.joints))
        for name in ("on", "names", "expressions", "values"):
            setting = getattr(self, name)
            object.__setattr__(self, name, None if setting is None else tuple(setting))
        self._check_on()
        for name, allowed in self.constants.items():
            object.__setattr__(self, name, self._check_constant(name, getattr(self, name), allowed))
        count, on, term = len(self._columns), self.acts_on, type(self).__name__
        owners = "joints" if count == len(on) else "parameters of joints"
        for name in ("names", "expressions", "values"):
            setting = getattr(self, name)
            if setting is not None and len(setting) != count:
                raise ModelError(f"{term}: {len(setting)} {name} for {count} {owners} ({', '.join(on)}).")

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
        places = {joint: f"{where} of joint {joint!r}" for joint in self.acts_on}
        return tuple((joint, _check_numbers(pairs[joint], place, allowed)) for joint, place in places.items())

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
        columns = self._constants_by_column
        if name not in columns:
            columns[name] = np.array([self.constant(name, self.joints[j].name) for j in self._columns], dtype=float)
        return columns[name]

    @cached_property
    def _constants_by_column(self) -> dict[str, Array]:
        """The constants that ``by_column`` has found so far, by name."""
        return {}

    def for_joint(self, joint: str) -> Self:
        """Return the term on one of its joints alone, with the default names of its parameters."""
        constants = {name: self.constant(name, joint) for name in self.constants}
        return replace(self, on=(joint,), names=None, expressions=None, values=None, **constants)

    @cached_property
    def _own_joints(self) -> list[Joint]:
        """The joints that the term acts on, in the order of ``on``."""
        joints_by_name = {joint.name: joint for joint in self.joints}
        return [joints_by_name[name] for name in self.acts_on]

    @cached_property
    def _columns(self) -> list[int]:
        """Index of the joint that each parameter acts on."""
        return [self.joints.index(joint) for joint in self._own_joints for _ in range(self.count(joint))]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of each joint in ``on``, in that order."""
        own_terms = ((joint, self.for_joint(joint.name)) for joint in self._own_joints)
        descriptions = [description for joint, term in own_terms for description in term.described(joint)]
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
        joints, diagonal, matrices = self._columns, range(q.shape[1]), np.zeros((3, *q.shape, q.shape[1]))
        # a torque depends on its own joint only: the derivatives are diagonal
        slopes = self.slopes(q[:, joints], dq[:, joints], ddq[:, joints], *memory)
        for matrix, slope in zip(matrices, slopes, strict=True):
            if slope is not None:
                matrix[:, diagonal, diagonal] = self._sum_by_joint(slope * theta)
        return Partials(*matrices)

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
        return np.asarray(x @ np.eye(len(self.joints))[self._columns])

    @property
    def equations(self) -> tuple[Equation, ...]:
        """The equation of each joint in ``on``; none where a subclass overrides the torque alone."""
        equations, start = [], 0
        for joint in self._own_joints:
            equation = self.equation(joint)
            if equation is None:
                return ()
            names = tuple(parameter.name for parameter in self.parameters[start : start + len(equation.symbols)])
            start += len(equation.symbols)
            equations.append(replace(equation, parameters=names, on=((joint.name, 1.0),)))
        return tuple(equations)

    def equation(self, joint: Joint) -> Equation | None:  # noqa: ARG002
        """Return the torque at a joint as an equation, without its ``parameters`` and ``on``; None: not known."""
        return None

    def formula(self) -> str:
        """Return ``shapes`` as NumPy source, of q, dq, ddq and the load; empty where it is not known."""
        is_known = "z" not in self.states and type(self).shapes is JointTerm.shapes
        return self._source_of(self.law) if is_known else ""

    def _source_of(self, law: str) -> str:
        constants = {name: self.source(name) for name in self._constant_names if name in names_in(law)}
        return rename(law, {name: f"np.{name}" for name in LAW_FUNCTIONS} | constants)

    def source(self, name: str) -> str:
        """Return a shape constant as NumPy source, for ``formula``."""
        numbers = self.by_column(name).tolist()
        # a single number where the constant is the same everywhere
        return repr(numbers[0]) if len(set(numbers)) == 1 else f"np.array({numbers!r})"

    def numpy_source(self, name: str, theta: Array) -> str:
        """Return the text of a function of q, dq and ddq that gives Y theta; ModelError without a ``formula``.

        The load is that of a function ``_load(q, dq, ddq)``.
        """
        if not (formula := self.formula()):
            cls = type(self).__name__
            raise ModelError(f"model.py cannot hold the term {cls}: give its formula by a method `{cls}.formula`.")
        # the load depends on all joints: take it before the states are reduced to the joints of the term
        load = "    load = _load(q, dq, ddq)[:, joints]\n" if "load" in self.states else ""
        return (
            f"def {name}(q, dq, ddq):\n"
            f"    joints = {self._columns!r}\n{load}"
            f"    q, dq, ddq = q[:, joints], dq[:, joints], ddq[:, joints]\n"
            f"    return (np.array({theta.tolist()!r}) * ({formula})) @ np.eye({len(self.joints)})[joints]\n"
        )

    def count(self, joint: Joint) -> int:  # noqa: ARG002
        """Return the number of parameters of a joint."""
        return 1

    @abstractmethod
    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameters of a joint, which is the only one in ``on``."""

    def shapes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Array:
        """Return the torque per unit of each parameter (N, p), for the motion (N, p) of its joint."""
        if not self.law:
            raise ModelError(f"{type(self).__name__}: give its torque as text by `law`, or by a method `shapes`.")
        return evaluate_law(self.law, self._law_values(q, dq, ddq, *memory), q.shape)

    def slopes(self, q: Array, dq: Array, ddq: Array, /, *memory: Array) -> Slopes:
        """Return the derivatives of ``shapes`` by q, dq and ddq, each (N, p), or None for zero."""
        values, names = self._law_values(q, dq, ddq, *memory), names_in(self.law)
        by_q, by_dq, by_ddq = (
            differentiate_law(self.law, values, name, q.shape) if name in names else None for name in ("q", "dq", "ddq")
        )
        return by_q, by_dq, by_ddq

    def _law_values(self, q: Array, dq: Array, ddq: Array, *memory: Array) -> dict[str, Array]:
        states = np.split(memory[0], len(self.states), axis=1) if self.states else ()
        constants = {name: self.by_column(name) for name in self._constant_names}
        return {"q": q, "dq": dq, "ddq": ddq, **dict(zip(self.states, states, strict=True)), **constants}

    @property
    def _constant_names(self) -> list[str]:
        """What the law names besides the motion and the memory."""
        return [name for name in names_in(self.law) if name not in ("q", "dq", "ddq", *self.states)]

    @property
    def memory(self) -> int:
        """The states of each parameter."""
        return len(self.states) * len(self._columns)

    def remember(self, past: Past) -> Array:
        """Return the states at the samples of a motion, shape (N, m), of all parameters one state after the other."""
        parts = [self.remember_state(past) if name == "z" else past.load[:, self._columns] for name in self.states]
        return np.concatenate([np.zeros((len(past.t), 0)), *parts], axis=1)

    def remember_state(self, past: Past) -> Array:
        """Return the states ``z`` (N, p) at the samples of a motion."""
        raise NotImplementedError


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
    """Base of terms with one parameter for each joint in ``on``: tau_j = theta_j f_j, f_j by the text ``law``.

    A subclass says also its ``words``, the meaning of the parameter, and where it is no torque its ``unit_text``; both
    are formats of the constants and of {unit} and {effort} of the joint. ``symbol`` is the prefix of the parameters'
    names, in equations with the rest of it as a subscript, or ``letter``. Further fields are settings; those in
    ``constants`` may be given by joint, see ``JointTerm``.
    """

    symbol: ClassVar[str]
    letter: ClassVar[str] = ""
    words: ClassVar[str] = ""
    unit_text: ClassVar[str] = "{effort}"

    def described(self, joint: Joint) -> Iterator[tuple[str, str, str]]:
        """Yield default name, unit and meaning of the parameter of a joint."""
        yield f"{self.symbol}_{joint.name}", self.unit(joint), self.meaning()

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return self._format(self.unit_text, joint)

    def meaning(self) -> str:
        """Return the meaning of the parameter, of a term on one joint."""
        return self._format(self.words, self._own_joints[0])

    def _format(self, text: str, joint: Joint) -> str:
        constants = {name: self.constant(name, joint.name) for name in self.constants}
        return text.format(unit=joint.unit, effort=joint.effort, **constants)

    def equation(self, joint: Joint) -> Equation | None:
        """Return the torque at a joint as an equation; None for a law of functions that equations have not."""
        law = self.law_at(joint)
        if not functions_in(law) <= FUNCTIONS.keys():
            return None
        used = [name for name in names_in(law) if name in self.constants]
        letters = {name: self.constants[name].letter or name for name in used}
        constants = tuple(
            (letters[name], self.constant(name, joint.name), self._format(self.constants[name].unit, joint))
            for name in used
        )
        letter = self.letter or "_".join(filter(None, (self.symbol[:1], self.symbol[1:])))
        torque = letter if law == CONSTANT_LAW else f"{letter} * {rename(law, letters)}"
        return Equation(torque, (letter,), constants)

    def law_at(self, joint: Joint) -> str:  # noqa: ARG002
        """Return the law at a joint, in the functions that an equation may hold."""
        return self.law


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
    law = "dq"
    words = "viscous friction: torque per dq"
    unit_text = "{effort} s/{unit}"
