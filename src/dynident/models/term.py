"""The base of a term: one physical effect, linear in its parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from reprlib import repr as short_repr
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dynident.runtime import ModelError, Noun, Part, brief
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    from dynident.models.robot_files import RobotFile, RobotJointLimits


def _sign(x: Array, band: float = 0.0) -> Array:
    return np.where(np.abs(x) > band, np.sign(x), 0.0)


FUNCTIONS: Mapping[str, Any] = MappingProxyType(
    {"abs": np.abs, "cos": np.cos, "exp": np.exp, "sign": _sign, "sin": np.sin, "sqrt": np.sqrt, "tanh": np.tanh}
)
"""The functions that an equation may hold; ``sign(x, band)`` is 0 where abs(x) <= band."""


@dataclass(frozen=True)
class Equation:
    """The torque of a term at one joint, or of a motor that is coupled to several, as text.

    ``torque`` is a Python expression of the motion ``q``, ``dq``, ``ddq`` of the joint or motor, of the time ``t`` (s)
    since the recording began, the ``load`` and the state ``z`` that the term remembers, of ``symbols``, one for each
    of ``parameters`` (names), and of ``constants``: symbol, value and unit. Its functions are those of FUNCTIONS; an
    underscore begins a subscript, as in "F_c * sign(dq)". ``where`` holds further symbols with their expressions.
    ``on`` names the joints that the torque acts on, with its factor there; ``motor`` is the name of a motor, whose
    position is the sum of the positions times these factors.
    """

    torque: str
    symbols: tuple[str, ...]
    constants: tuple[tuple[str, float, str], ...] = ()
    where: tuple[tuple[str, str], ...] = ()
    parameters: tuple[str, ...] = ()
    on: tuple[tuple[str, float], ...] = ()
    motor: str = ""


@dataclass(frozen=True)
class Joint:
    """A generalised coordinate: its name, and whether it turns (rad, N m) or slides (m, N).

    >>> import dynident as dy
    >>> dy.Joint("rail", "prismatic").effort
    'N'
    """

    name: str
    kind: Literal["revolute", "prismatic"] = "revolute"

    @property
    def unit(self) -> str:
        """Unit of the position."""
        return "rad" if self.kind == "revolute" else "m"

    @property
    def effort(self) -> str:
        """Unit of the torque or force."""
        return "N m" if self.kind == "revolute" else "N"


def check_joints(term: object, joints: object) -> tuple[Joint, ...]:
    """Return the joints of a term, a single one as a tuple; ModelError for anything else, such as a name."""
    sequence = (joints,) if isinstance(joints, Joint | str) or not isinstance(joints, Iterable) else tuple(joints)
    for joint in sequence:
        if not isinstance(joint, Joint):
            raise ModelError(
                f"{type(term).__name__}: joints has {short_repr(joint)}, a {type(joint).__name__}; give the joints "
                "of a model, `model.joints`, or Joint(name, kind)."
            )
    return sequence


INERTIAL = ("mass", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""The 10 standard parameters of a rigid body, in the order of the regressor: about the origin of its joint frame."""


@dataclass(frozen=True)
class Parameter:
    """One column of the regressor: its name, unit, and ``expression``, its meaning as text or as a formula.

    ``value`` is the nominal value where it is known (the true value of a simulated arm, the robot file's for a real
    arm). ``role`` tells estimators which physical constraints apply: one of INERTIAL (with the ``body`` it belongs to),
    "viscous", "coulomb", "rotor" (none of these may be negative), or "" (unconstrained).
    """

    name: str
    unit: str
    expression: str = ""
    value: float | None = None
    role: str = ""
    body: str = ""


@dataclass(frozen=True, eq=False)
class Partials:
    """Partial derivatives of the torque: ``dq[i, j, k]`` = d tau_j / d dq_k at sample i; each (N, n, n)."""

    q: Array
    dq: Array
    ddq: Array

    __repr__ = brief


class Past(Noun):
    """An uninterrupted motion, as it is given to terms with memory: ``t`` (N) s; ``q``, ``dq``, ``ddq`` (N, n).

    ``load`` (N, n), N m or N, is the torque of the bodies by a first fit, zero where there is none; ``start`` (m)
    is the memory at the first sample, None where the recording begins.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    load: Array
    start: Array | None = None


class Term(Part, ABC):
    """Base of all terms, each an effect of the model: tau_term = Y(q, dq, ddq) theta_term.

    A term is a frozen, picklable dataclass, vectorised over samples: q, dq, ddq are (N, n). It has ``joints``,
    ``parameters`` and ``regressor``, and ``partials`` for whatever needs derivatives. Everything else has a default,
    which stands for a term that has no such thing, or computes it by the regressor; ``has_own`` tells. A subclass with
    another regressor goes back to the defaults of what ``FOLLOWS`` names, unless it defines them, too.

    The torque of a term with ``memory`` depends on the motion before a sample, as that of hysteresis does. It remembers
    m numbers, its states. These are found once for a whole recording and given to ``regressor``, ``partials``,
    ``torque``, ``entries`` and ``weighted_gradient`` as a further, last argument ``memory`` (N, m), so that these are
    functions of single samples as those of any term; ``partials`` are at constant memory. At constant memory, the
    torque does not depend on ddq.
    """

    FOLLOWS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **dict.fromkeys(("torque", "support", "entries", "mass_and_bias", "equations"), ("regressor",)),
        "weighted_gradient": ("partials",),
    }
    """What says something of another method, and is wrong for a subclass that overrides only that one."""
    title: ClassVar[str] = ""
    """What people call the term; one without goes by its class. It is not inherited."""
    needs_load: ClassVar[bool] = False
    """Whether the term remembers the load: then a first fit without it finds the load."""
    loads: ClassVar[bool] = False
    """Whether the torque of the term is the load of the drives, as that of moving bodies is."""

    # fields of subclasses: at run time a property of this class would be taken for their default
    if TYPE_CHECKING:

        @property
        def joints(self) -> tuple[Joint, ...]:
            """All n joints of the arm, in the order of the columns of q."""

        @property
        def parameters(self) -> tuple[Parameter, ...]:
            """The p parameters of this term, in the order of the regressor's columns."""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        # the nearer class knows of the other: what comes from behind an overridden method returns to its default
        order = cls.__mro__
        for name, methods in cls.FOLLOWS.items():
            ranks = [k for k, base in enumerate(order) if name in vars(base)]
            if any(method in vars(base) for base in order[: ranks[0]] for method in methods):
                setattr(cls, name, vars(order[ranks[-1]])[name])

    def has_own(self, name: str) -> bool:
        """Return whether the term has another ``name``, such as "torque", than the default."""
        return getattr(type(self), name) is not getattr(Term, name)

    @abstractmethod
    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y, shape (N, n, p)."""

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:  # noqa: ARG002
        """Return the partial derivatives of Y theta with respect to q, dq and ddq, each (N, n, n)."""
        raise ModelError(f"the term {type(self).__name__} has no derivatives; give it a method `partials`.")

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return Y theta, shape (N, n), for one theta (p)."""
        return self.regressor(q, dq, ddq) @ theta

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n), and the torque (N, n) without acceleration, for one theta (p)."""
        bias = self.torque(q, dq, np.zeros_like(q), theta)
        units = (np.broadcast_to(unit, q.shape) for unit in np.eye(q.shape[1]))
        return np.stack([self.torque(q, dq, unit, theta) - bias for unit in units], axis=2), bias

    def weighted_gradient(self, q: Array, dq: Array, ddq: Array, weights: Array, *memory: Array) -> Array:
        """Return the derivatives (3, N, n) by q, dq and ddq of the sums <G_i, Y_i> for weights G (N, n, p)."""
        slopes = [self.partials(q, dq, ddq, unit, *memory) for unit in np.eye(weights.shape[2])]
        by_parameter = np.array([(slope.q, slope.dq, slope.ddq) for slope in slopes])
        return np.asarray(np.einsum("ijp,psijk->sik", weights, by_parameter))

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, p)."""
        return np.ones((len(self.joints), len(self.parameters)), dtype=bool)

    def entries(
        self, q: Array, dq: Array, ddq: Array, joint: NDArray[np.intp], parameter: NDArray[np.intp], *memory: Array
    ) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows m, shape (M, N).

        Where a term has its own, and several parameters act on a joint, their columns are analytic in the states, so
        that those that are dependent at enough random states always are.
        """
        return self.regressor(q, dq, ddq, *memory)[:, joint, parameter].T

    @property
    def memory(self) -> int:
        """The number m of states that the term remembers."""
        return 0

    def remember(self, past: Past) -> Array:
        """Return the states at the samples of a motion, shape (N, m).

        Where a motion is cut in two that share a sample, and the second starts with the memory of the first there,
        the states are those of the whole.
        """
        return np.zeros((len(past.t), 0))

    @property
    def gravity(self) -> tuple[float, ...] | None:
        """Gravity (3) in the frame of the root link, m/s^2; None where the term has none."""
        return None

    def with_gravity(self, gravity: tuple[float, ...]) -> Term:  # noqa: ARG002
        """Return the term under another gravity (3), m/s^2: the same where it has none."""
        return self

    @property
    def file(self) -> RobotFile | None:
        """What the robot file says that the term was made from; its gravity may not be the one that is used."""
        return None

    def with_displacement(self, joint: str, by: tuple[float, ...]) -> Term:  # noqa: ARG002
        """Return the term with a joint displaced further by (9): the same where it has no frames of joints.

        These are x, y, z (m) of its origin along the axes of its parent link's frame, then rotation vectors (rad) in
        its own frame, of the frame with all that it carries and of the axis alone.
        """
        return self

    @property
    def limits(self) -> Mapping[str, RobotJointLimits]:
        """Limits of the joints by name, where the term knows them."""
        return {}

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user, such as what of a robot file is ignored."""
        return ()

    @property
    def discontinuous(self) -> bool:
        """Whether the torque jumps with the sign of a velocity."""
        return False

    def with_smooth_sign(self, width: Array) -> tuple[Term, ...]:  # noqa: ARG002
        """Return terms with the same parameters in which sign(dq) is tanh(dq / width), ``width`` (n) by joint."""
        return (self,)

    @property
    def equations(self) -> tuple[Equation, ...]:
        """The torque for people: one equation for each joint or motor with parameters; empty where there is none."""
        return ()

    def numpy_source(self, name: str, theta: Array) -> str:  # noqa: ARG002
        """Return the text of a function ``name(q, dq, ddq)`` that gives Y theta (N, n), theta (p), by NumPy (``np``).

        It is for the exported module. Raises ModelError where there is no such text.
        """
        raise ModelError(
            f"model.py cannot hold the term {type(self).__name__}: its formula is not known. Give the term a method "
            "`numpy_source`, use the model in Python (`dynident.models.Model`), or write the term with `Lagrangian`."
        )
