"""What the checks find wrong with the robot or its model, as data: each is the message of a ``Finding``.

``share`` is the share of the squared training residual, each joint weighted by its own noise, that the correction
removes; ``std`` are standard errors robust to correlated residuals. ``report/robot_words.py`` puts them into words.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from dynident.errors import Note, Use

__all__ = ["AxisTilted", "Channel", "ColumnReversed", "JointsSwapped", "LengthWrong", "MissingTerm", "OtherAxis",
           "OtherPayload", "Quantity", "Rival", "TermKind", "TorqueGain", "ZeroOff"]  # fmt: skip


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
    COUPLED = "coupled motor"


class Quantity(StrEnum):
    """What an unknown is, and what its value means."""

    GAIN = "gain"
    ZERO = "zero"
    LENGTH = "length"
    AXIS = "axis"


@dataclass(frozen=True)
class Rival:
    """Another unknown that explains the residual as well: the factor of a gain, else a change in rad or m."""

    joint: str
    quantity: Quantity
    value: float


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
class TorqueGain(Note):
    """The torque of a joint is ``factor`` times what the others ask for; ``others`` explain the residual as well."""

    forbids: ClassVar[Use | None] = Use.SIMULATION
    factor: float
    std: float
    share: float
    others: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class ZeroOff(Note):
    """The robot's joint stands at the logged position plus ``offset`` (rad or m)."""

    forbids: ClassVar[Use | None] = Use.SIMULATION
    offset: float
    std: float
    share: float
    others: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class LengthWrong(Note):
    """A component ("x", "y" or "z", in the parent link's frame) of a joint's origin: in the file and as fitted (m)."""

    forbids: ClassVar[Use | None] = Use.SIMULATION
    component: str
    given: float
    fitted: float
    std: float
    share: float
    others: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class AxisTilted(Note):
    """A joint's frame, or its axis ``alone``, is turned by ``angle`` (rad) about an ``axis`` (3) of its own frame."""

    forbids: ClassVar[Use | None] = Use.SIMULATION
    axis: tuple[float, ...]
    angle: float
    alone: bool
    std: float
    share: float
    others: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class MissingTerm(Note):
    """An effect that the model lacks at a joint: its value in SI units, and the share of that joint's own residual
    (squared) that it removes; ``partner`` is the other joint of a coupled motor."""

    effect: TermKind
    value: float
    std: float
    share: float
    partner: str = ""


@dataclass(frozen=True)
class OtherPayload(Note):
    """The last link is ``mass`` (kg) heavier in one log than in training, which explains ``share`` of that log's
    residual (squared)."""

    mass: float
    std: float
    share: float
