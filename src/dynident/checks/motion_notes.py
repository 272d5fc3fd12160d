"""What the checks find in a motion, against the robot file's limits and the model, as data."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from dynident.errors import Note

__all__ = [
    "CorrelatedParameters",
    "EffortAboveLimit",
    "EffortFarBelowLimit",
    "FewReversals",
    "HardlyMoves",
    "LoopDiffers",
    "LoopGain",
    "LoopUnused",
    "LoopVelocity",
    "PositionBeyondLimits",
    "Search",
    "SearchLeftOut",
    "VelocityAboveLimit",
]


@dataclass(frozen=True)
class FewReversals(Note):
    """How often a joint reverses."""

    count: int


@dataclass(frozen=True)
class HardlyMoves(Note):
    """How far a joint moves in all of the training, about ``near``, and the joint that moves the most (rad or m)."""

    span: float
    largest: float
    near: float
    unit: str


@dataclass(frozen=True)
class LoopDiffers(Note):
    """The share of its torque by which a joint's controller, at the measured motion, asks for another one."""

    error: float


@dataclass(frozen=True)
class LoopGain(Note):
    """The measured torque is ``factor`` times what the controller asks for; ``error`` and ``left`` are the shares of it
    by which the two differ without and with the factor."""

    factor: float
    error: float
    left: float


@dataclass(frozen=True)
class LoopUnused(Note):
    """Columns that are named as reference positions, of which no controller makes use."""

    columns: tuple[str, ...]


@dataclass(frozen=True)
class LoopVelocity(Note):
    """Over how many steps drives difference positions: as ``given``, and the number with which they ask for the
    measured torque but for a share ``left``, instead of ``error``; none where they are faster than they are said to be.
    """

    given: int
    steps: int
    error: float
    left: float


@dataclass(frozen=True)
class PositionBeyondLimits(Note):
    """The range of a position, and the one that the robot file allows (rad or m); ``far`` beyond it is a motor's."""

    lower: float
    upper: float
    least: float
    most: float
    far: bool = False


@dataclass(frozen=True)
class VelocityAboveLimit(Note):
    """A peak velocity and its limit in the robot file (rad/s or m/s)."""

    peak: float
    limit: float


@dataclass(frozen=True)
class EffortAboveLimit(Note):
    """A peak torque and its limit in the robot file, in ``unit``; ``far`` above it is another quantity or unit."""

    peak: float
    limit: float
    unit: str
    far: bool


@dataclass(frozen=True)
class EffortFarBelowLimit(Note):
    """A peak torque below a thousandth of its limit in the robot file, in ``unit``."""

    peak: float
    limit: float
    unit: str


@dataclass(frozen=True)
class CorrelatedParameters(Note):
    """The number of base parameters, and their condition number in these motions."""

    rank: int
    condition: float


class Search(StrEnum):
    """What is not looked for in a model of many joints."""

    FITS = "whatever needs a fit"
    CAUSES = "what explains the residual"
    PAIRS = "exchanged columns of joints that are no neighbours"


@dataclass(frozen=True)
class SearchLeftOut(Note):
    """What was not looked for, as the model has so many joints and parameters."""

    search: Search
    joints: int
    parameters: int
