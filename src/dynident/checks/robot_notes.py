"""Notes on the robot or its model, as data: each is the message of a ``Finding``.

``share`` is the share of the squared training residual, with each joint weighted by its own noise, that the
correction removes; ``std`` are standard errors robust to correlated residuals. ``report/robot_words.py`` puts
them into words.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar

from dynident.runtime import Note, Use

MAX_CONTROL_COST, MAX_JOINT_COST = (
    10.0,
    25.0,
)  # %, of the torque and of one joint's: the verdict's limits of held-out errors
MAX_SIMULATION_COST = 5.0  # %, of the torque; what real robots have beside the usual terms is 2 to 4 %


class AffectedColumns(StrEnum):
    """The columns of a log that are affected."""

    POSITION = "position"
    TORQUE = "torque"
    BOTH = "position and torque"


class TermKind(StrEnum):
    """An effect that a model may lack."""

    VISCOUS = "viscous"
    COULOMB = "coulomb"
    SMOOTH = "smooth sign of Coulomb friction"
    OFFSET = "offset"
    ROTOR = "rotor"
    SPRING = "spring"
    ASYMMETRIC = "asymmetric viscous friction"
    QUADRATIC = "quadratic friction"
    STRIBECK = "Stribeck friction"
    LOAD = "load-dependent friction"
    DRIFT = "friction that drifts"
    DELAY = "delay of the torque"
    SATURATION = "torque that saturates"
    COUPLED = "coupled motor"
    NEIGHBOUR = "torque of a neighbour"
    RIPPLE = "ripple"


class SuspectQuantity(StrEnum):
    """The kinds of unknowns, which say what their values mean."""

    GAIN = "gain"
    ZERO = "zero"
    LENGTH = "length"
    AXIS = "axis"
    CLOCK = "clock"


@dataclass(frozen=True)
class Rival:
    """Another unknown that explains the residual as well: the factor of a gain or clock, else a change in rad or m."""

    joint: str
    quantity: SuspectQuantity
    value: float


@dataclass(frozen=True)
class Costly(Note):
    """Base of notes that forbid a use by what the fault costs.

    ``cost`` is the change of the torque, in % of all joints together, on the training motion at twice its speed;
    ``removed`` is what the correction removes of the low-passed residual, by joint.
    """

    cost: float = field(default=0.0, kw_only=True)
    removed: tuple[tuple[str, float], ...] = field(default=(), kw_only=True)

    @property
    def forbidden(self) -> Use | None:
        """Control where the cost is large, simulation where it is more than a fit of a real robot leaves."""
        return (
            Use.CONTROL
            if self.cost > MAX_CONTROL_COST
            else Use.SIMULATION
            if self.cost > MAX_SIMULATION_COST
            else self.forbids
        )


@dataclass(frozen=True)
class WrongValue(Costly):
    """Base of values that a model takes as known and that are wrong; ``joint_cost`` (%) is that of the worst joint.

    The user can correct them, so that any of them forbids simulation.
    """

    forbids: ClassVar[Use | None] = Use.SIMULATION
    joint_cost: float = field(default=0.0, kw_only=True)

    @property
    def forbidden(self) -> Use | None:
        """Control where a joint's torque is far off, else simulation."""
        return Use.CONTROL if self.joint_cost > MAX_JOINT_COST else self.forbids


@dataclass(frozen=True)
class JointsSwapped(Note):
    """The columns of two joints fit the other joint better.

    ``before`` and ``after`` are the errors (%) of the torque, mean over the joints.
    """

    forbids: ClassVar[Use | None] = Use.CONTROL
    joints: tuple[str, str]
    channel: AffectedColumns
    before: float
    after: float


@dataclass(frozen=True)
class ColumnReversed(Note):
    """The columns of a joint fit with the other sign; errors (%) as above."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    channel: AffectedColumns
    before: float
    after: float


@dataclass(frozen=True)
class OtherAxis(Note):
    """Another axis (3) of a joint, in its own frame, fits better than that of the file; errors (%) as above."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    given: tuple[float, ...]
    fitted: tuple[float, ...]
    before: float
    after: float


@dataclass(frozen=True)
class TorqueGain(WrongValue):
    """The torque of a joint is ``factor`` times what the other joints require.

    ``others`` explain the residual as well.
    """

    factor: float
    std: float
    share: float
    others: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class ClockWrong(WrongValue):
    """A second of the stamps is ``factor`` seconds; ``others`` explain the residual as well."""

    factor: float
    std: float
    share: float
    others: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class ZeroOff(WrongValue):
    """The robot's joint stands at the logged position plus ``offset`` (rad or m)."""

    offset: float
    std: float
    share: float
    others: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class LengthWrong(WrongValue):
    """A component ("x", "y" or "z", in the parent link's frame) of a joint's origin: in the file and as fitted (m)."""

    component: str
    given: float
    fitted: float
    std: float
    share: float
    others: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class AxisTilted(WrongValue):
    """A joint's frame, or its axis ``alone``, is turned by ``angle`` (rad) about an ``axis`` (3) of its own frame."""

    axis: tuple[float, ...]
    angle: float
    alone: bool
    std: float
    share: float
    others: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class TiltedBase(WrongValue):
    """The base is turned by ``x`` and then ``y`` (rad) about these axes; ``std`` of both; errors (%) of the torque."""

    x: float
    y: float
    std: tuple[float, float]
    before: float
    after: float


@dataclass(frozen=True)
class MissingTerm(Costly):
    """An effect that the model lacks at a joint: its value in SI units.

    ``share`` is that of the joint's own squared residual that it removes. ``partner`` is the other joint of a
    coupled motor or torque, ``period`` that of a ripple (rad or m). The value of a saturation is the share of the
    torque that is lost at its rms.
    """

    effect: TermKind
    value: float
    std: float
    share: float
    partner: str = ""
    period: float = 0.0


@dataclass(frozen=True)
class TermLeftOut(MissingTerm):
    """A missing effect that the library has as a term, so that it forbids simulation at any cost."""

    forbids: ClassVar[Use | None] = Use.SIMULATION


@dataclass(frozen=True)
class LeftAtReversals(Note):
    """The residual torque near the reversals of a joint.

    ``left`` % of its torque are left within 50 ms of them, beyond what is left elsewhere. ``share`` is its share
    of the joint's squared residual as measured. Backlash and elastic gears do this, and friction that builds up
    gradually, which the torque alone does not tell.
    """

    left: float
    share: float


@dataclass(frozen=True)
class Unexplained(Note):
    """The low-passed torque that is neither white noise nor explained by anything searched: ``left`` % of it.

    ``joint_left`` (%) is that of the joint of the finding, of which the most is left. The model lacks something,
    unless the sensors' noise is slow: that forbids simulation.
    """

    forbids: ClassVar[Use | None] = Use.SIMULATION
    left: float
    joint_left: float


@dataclass(frozen=True)
class OtherPayload(Costly):
    """The last link is ``mass`` (kg) heavier in one log than in training.

    This explains ``share`` of the squared residual of both. A model of one payload is not valid for the other:
    any forbids simulation, and a large one control. The ``cost`` is the torque of the payload in that log.
    """

    forbids: ClassVar[Use | None] = Use.SIMULATION
    mass: float
    std: float
    share: float


@dataclass(frozen=True)
class OddLog(Note):
    """One log does not fit together with the others.

    One fit of all logs leaves ``before`` % of the torque, mean over the joints; with a separate fit of this log
    ``after`` %. What was modelled has changed between the logs, so that it forbids simulation.
    """

    forbids: ClassVar[Use | None] = Use.SIMULATION
    before: float
    after: float
