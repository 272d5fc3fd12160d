"""Next steps to improve a model: remedies of the reasons against it, and motions to record."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

__all__ = ["CheckRipple", "ExcitingMotion", "Remedy", "Sharpen", "SlowReversals", "Step"]


class Remedy(Enum):
    """What to do about a reason against a use."""

    CORRECT = auto()
    HOLD_OUT = auto()
    ANOTHER_MOTION = auto()
    CHECK = auto()
    TORQUE_COLUMN = auto()
    LONGER_TRAINING = auto()
    EXCITE = auto()
    CONSISTENT_FIT = auto()
    SIMULATE = auto()
    CONTROLLER_LOOP = auto()


class ExcitingMotion(Enum):
    """How a joint should move to excite a parameter, which acts through velocity, position or acceleration."""

    CONSTANT_SPEEDS = auto()
    MANY_POSES = auto()
    ACCELERATE = auto()


@dataclass(frozen=True)
class Step:
    """Base of the next steps that follow from the data, besides remedies and unexcited base parameters."""


@dataclass(frozen=True)
class Sharpen(Step):
    """Record a motion that excites a ``parameter`` better.

    Its ``value`` has the standard error ``std`` (both in SI units), which is ``share`` % of the torque.
    ``joint`` is the one to move, None for all of them.
    """

    parameter: str
    value: float
    std: float
    share: float
    excitation: ExcitingMotion
    joint: str | None


@dataclass(frozen=True)
class SlowReversals(Step):
    """Record slow motion of the ``joints`` through zero speed, or smooth their Coulomb friction."""

    joints: tuple[str, ...]


@dataclass(frozen=True)
class CheckRipple(Step):
    """Record constant speeds of the ``joints`` to see whether the ripple follows the position."""

    joints: tuple[str, ...]
