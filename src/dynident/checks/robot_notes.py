"""What the checks find wrong with the robot or its model, as data: each is the message of a ``Finding``.

``share`` is the share of the squared training residual, each joint weighted by its own noise, that the correction
removes; ``std`` are standard errors robust to correlated residuals. ``report/robot_words.py`` puts them into words.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar

from dynident.errors import Note, Use

__all__ = ["AxisTilted", "Channel", "ClockWrong", "ColumnReversed", "Costly", "JointsSwapped",
           "LeftAtReversals", "LengthWrong", "MissingTerm", "OddLog", "OtherAxis", "OtherPayload", "Quantity", "Rival",
           "TermKind", "TermLeftOut", "TiltedBase", "TorqueGain", "Unexplained", "WrongValue", "ZeroOff"]  # fmt: skip

CONTROL, JOINT = 10.0, 25.0  # %, of the torque and of one joint's: the verdict's limits of held-out errors
SIMULATION = 5.0  # %, of the torque; what real robots have beside the usual terms is 2 to 4 %


class Channel(StrEnum):
    """Which columns of a log are concerned."""

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


class Quantity(StrEnum):
    """What an unknown is, and what its value means."""

    GAIN = "gain"
    ZERO = "zero"
    LENGTH = "length"
    AXIS = "axis"
    CLOCK = "clock"


@dataclass(frozen=True)
class Rival:
    """Another unknown that explains the residual as well: the factor of a gain or clock, else a change in rad or m."""

    joint: str
    quantity: Quantity
    value: float


@dataclass(frozen=True)
class Costly(Note):
    """Base of what forbids a use by what it costs: ``cost`` is the change of the torque, in %, of all joints together,
    on the training motion at twice its speed; ``removed`` is what it removes of the low-passed residual, by joint."""

    cost: float = field(default=0.0, kw_only=True)
    removed: tuple[tuple[str, float], ...] = field(default=(), kw_only=True)

    @property
    def forbidden(self) -> Use | None:
        """Control where the cost is large, simulation where it is more than a fit of a real robot leaves."""
        return Use.CONTROL if self.cost > CONTROL else Use.SIMULATION if self.cost > SIMULATION else self.forbids


@dataclass(frozen=True)
class WrongValue(Costly):
    """Base of values that a model takes for known and that are wrong; ``joint_cost`` (%) is that of the worst joint.

    The user can set them right, so that any forbids simulation.
    """

    forbids: ClassVar[Use | None] = Use.SIMULATION
    joint_cost: float = field(default=0.0, kw_only=True)

    @property
    def forbidden(self) -> Use | None:
        """Control where a joint's torque is far off, else simulation."""
        return Use.CONTROL if self.joint_cost > JOINT else self.forbids


@dataclass(frozen=True)
class JointsSwapped(Note):
    """The columns of two joints fit the other one; errors (%) of the torque, mean over the joints, before and after."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    joints: tuple[str, str]
    channel: Channel
    before: float
    after: float


@dataclass(frozen=True)
class ColumnReversed(Note):
    """The columns of a joint fit with the other sign; errors (%) as above."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    channel: Channel
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
    """The torque of a joint is ``factor`` times what the others ask for; ``others`` explain the residual as well."""

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
    """An effect that the model lacks at a joint: its value in SI units, and the share of that joint's own residual
    (squared) that it removes; ``partner`` is the other joint of a coupled motor or torque, ``period`` that of a ripple
    (rad or m). The value of a saturation is the share of the torque that is lost at its rms.
    """

    effect: TermKind
    value: float
    std: float
    share: float
    partner: str = ""
    period: float = 0.0


@dataclass(frozen=True)
class TermLeftOut(MissingTerm):
    """The same of a term that the library has: the user can add it, so that it forbids simulation at any cost."""

    forbids: ClassVar[Use | None] = Use.SIMULATION


@dataclass(frozen=True)
class LeftAtReversals(Note):
    """Of a joint's torque ``left`` % remain within 50 ms of its reversals, beyond what remains elsewhere: ``share`` of
    its squared residual as measured.

    Backlash and elastic gears do this, and friction that builds up gradually, which the torque alone does not tell.
    """

    left: float
    share: float


@dataclass(frozen=True)
class Unexplained(Note):
    """Of the low-passed torque ``left`` % remain that are no white noise, and that nothing sought explains; and the
    ``joint_left`` % of the joint of the finding, of which the most is left.

    The model lacks something, unless the sensors' noise is slow: that forbids simulation.
    """

    forbids: ClassVar[Use | None] = Use.SIMULATION
    left: float
    joint_left: float


@dataclass(frozen=True)
class OtherPayload(Costly):
    """The last link is ``mass`` (kg) heavier in one log than in training, which explains ``share`` of the
    squared residual of both.

    A model of one payload is none of the other: any forbids simulation, and a large one control. The ``cost`` is the
    torque of the payload in that log.
    """

    forbids: ClassVar[Use | None] = Use.SIMULATION
    mass: float
    std: float
    share: float


@dataclass(frozen=True)
class OddLog(Note):
    """One fit of all logs leaves ``before`` % of the torque, mean over the joints; with one of its own for this log
    ``after`` % are left.

    What the model is a model of has changed between the logs, so that it forbids simulation.
    """

    forbids: ClassVar[Use | None] = Use.SIMULATION
    before: float
    after: float
