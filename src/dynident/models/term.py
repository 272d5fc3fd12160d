"""The protocol of a term: one physical effect, linear in its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from dynident.models.equation import Equation
    from dynident.models.robot_file import Limits, RobotFile

from dynident.errors import brief

__all__ = [
    "INERTIAL",
    "HasEquations",
    "HasGeometry",
    "HasGravity",
    "HasLimits",
    "HasMassMatrix",
    "HasMemory",
    "HasNotes",
    "HasNumpySource",
    "HasRobotFile",
    "HasSign",
    "HasSupport",
    "HasWeightedGradient",
    "Joint",
    "Loads",
    "NeedsLoad",
    "Parameter",
    "Partials",
    "Past",
    "Recursive",
    "Selective",
    "Term",
    "declares",
]

Array = NDArray[np.float64]


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


@dataclass(frozen=True)
class Partials:
    """Partial derivatives of the torque: ``dq[i, j, k]`` = d tau_j / d dq_k at sample i; each (N, n, n)."""

    q: Array
    dq: Array
    ddq: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Past:
    """An uninterrupted motion as a term sees it that remembers: ``t`` (N) s; ``q``, ``dq``, ``ddq`` (N, n).

    ``load`` (N, n), N m or N, is the torque of the bodies by a first fit, zero where there is none; ``start`` (m) the
    memory at the first sample, None where the recording begins.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    load: Array
    start: Array | None = None

    __repr__ = brief


class Term(Protocol):
    """One effect of the model: tau_term = Y(q, dq, ddq) theta_term.

    A term is a frozen, picklable dataclass, vectorised over samples: q, dq, ddq are (N, n).
    """

    @property
    def joints(self) -> tuple[Joint, ...]:
        """All n joints of the arm, in the order of the columns of q."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The p parameters of this term, in the order of the regressor's columns."""

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y, shape (N, n, p)."""

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        """Return the partial derivatives of Y theta with respect to q, dq and ddq, each (N, n, n)."""


@runtime_checkable
class Recursive(Protocol):
    """A term that computes its torque faster than by the regressor."""

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return Y theta, shape (N, n), for one theta (p)."""


@runtime_checkable
class HasMassMatrix(Protocol):
    """A term that computes its mass matrix faster than by torques at unit accelerations."""

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n), and the torque (N, n) without acceleration, for one theta (p)."""


@runtime_checkable
class HasWeightedGradient(Protocol):
    """A term that computes the derivatives of a weighted sum of its regressor faster than by ``partials``."""

    def weighted_gradient(self, q: Array, dq: Array, ddq: Array, weights: Array, /, *memory: Array) -> Array:
        """Return the derivatives (3, N, n) by q, dq and ddq of the sums <G_i, Y_i> for weights G (N, n, p)."""


@runtime_checkable
class HasMemory(Protocol):
    """A term whose torque depends on the motion before a sample, as that of hysteresis does.

    What it remembers is a number of states, m. They are found once for a whole recording and given to ``regressor``,
    ``partials``, ``torque`` and ``entries`` as a further, last argument ``memory`` (N, m), so that these are functions
    of single samples as those of any term; ``partials`` are at constant memory. At constant memory, the torque does not
    depend on ddq.
    """

    @property
    def memory(self) -> int:
        """The number m of states."""

    def remember(self, past: Past, /) -> Array:
        """Return the states at the samples of a motion, shape (N, m).

        Where a motion is cut in two that share a sample, and the second starts with the memory of the first there,
        the states are those of the whole.
        """


@runtime_checkable
class NeedsLoad(HasMemory, Protocol):
    """A term that remembers the load."""

    @property
    def needs_load(self) -> bool:
        """Whether it does: then a first fit without the term finds the load."""


@runtime_checkable
class Loads(Protocol):
    """A term of moving bodies, whose torque is the load of the drives."""

    @property
    def loads(self) -> bool:
        """Whether it is."""


@runtime_checkable
class HasSupport(Protocol):
    """A term that knows which joints each of its parameters acts on."""

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, p)."""


@runtime_checkable
class Selective(HasSupport, Protocol):
    """A term that computes chosen entries of its regressor.

    Where several parameters act on a joint, their columns are analytic in the states, so that those that are dependent
    at enough random states always are.
    """

    def entries(
        self, q: Array, dq: Array, ddq: Array, joint: NDArray[np.intp], parameter: NDArray[np.intp], /, *memory: Array
    ) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows m, shape (M, N)."""


@runtime_checkable
class HasGravity(Protocol):
    """A term with gravity."""

    @property
    def gravity(self) -> tuple[float, ...]:
        """Gravity (3) in the frame of the root link, m/s^2."""

    def with_gravity(self, gravity: tuple[float, ...], /) -> Term:
        """Return the term under another gravity."""


@runtime_checkable
class HasGeometry(Protocol):
    """A term whose joints have frames that can be displaced."""

    @property
    def file(self) -> RobotFile:
        """What the file says of the frames."""

    def with_displacement(self, joint: str, by: tuple[float, ...], /) -> Term:
        """Return the term with a joint displaced further by (9).

        These are x, y, z (m) of its origin along the axes of its parent link's frame, then rotation vectors (rad) in
        its own frame, of the frame with all that it carries and of the axis alone.
        """


@runtime_checkable
class HasSign(Protocol):
    """A term whose torque may jump with the sign of a velocity."""

    @property
    def discontinuous(self) -> bool:
        """Whether the torque jumps with these settings."""

    def with_smooth_sign(self, width: Array, /) -> tuple[Term, ...]:
        """Return terms with the same parameters in which sign(dq) is tanh(dq / width), ``width`` (n) by joint."""


@runtime_checkable
class HasEquations(Protocol):
    """A term that can be written down for people."""

    @property
    def equations(self) -> tuple[Equation, ...]:
        """One for each joint or motor with parameters; empty where there is none."""


@runtime_checkable
class HasLimits(Protocol):
    """A term that knows the limits of its joints."""

    @property
    def limits(self) -> Mapping[str, Limits]:
        """Limits by joint name."""


@runtime_checkable
class HasNotes(Protocol):
    """A term with notes on the file it was made from."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user, such as what of a robot file is ignored."""


@runtime_checkable
class HasRobotFile(Protocol):
    """A term that was made from a robot file."""

    @property
    def source(self) -> str:
        """Name of the file."""

    @property
    def file(self) -> RobotFile:
        """What the file says."""

    @property
    def gravity(self) -> tuple[float, ...]:
        """Gravity (3) in the frame of the root link, m/s^2: the one that is used, which may not be the file's."""


@runtime_checkable
class HasNumpySource(Protocol):
    """A term that can be written for the exported module, which needs only NumPy."""

    def numpy_source(self, name: str, theta: Array, /) -> str:
        """Return the text of a function ``name(q, dq, ddq)`` of NumPy (``np``) that gives Y theta (N, n), theta (p).

        Raises ModelError where there is no such text.
        """


def declares(term: Term, name: str, of: str = "regressor") -> bool:
    """Return whether a term says something (``torque``, ``support``, ``entries``) of the regressor that it has, or of
    another method.

    A subclass with a regressor of its own does not inherit it.
    """
    order = type(term).__mro__
    first = {key: next((k for k, cls in enumerate(order) if key in vars(cls)), None) for key in (name, of)}
    own, base = first[name], first[of]
    return own is not None and base is not None and own <= base
