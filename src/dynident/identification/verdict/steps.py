"""Next steps to improve a model: remedies of the reasons against it, and motions to record."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

from dynident.errors import Finding

__all__ = ["CheckRipple", "Cover", "ExcitingMotion", "HoldOutFaster", "LeaveOut", "Remedy", "SetRight",
           "Sharpen", "SlowReversals", "Step"]  # fmt: skip


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
    """Base of the next steps that follow from the data, besides remedies and unexcited base parameters.

    ``gain``: by how many points (%) the unfiltered error of the held-out log where it is largest (without one, of the
    training log) may fall, None where the data do not tell.
    """

    gain: float | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class Sharpen(Step):
    """Record a motion that excites a ``parameter`` better.

    Its ``value`` has the standard error ``std`` (both in SI units), which is ``share`` % of the torque.
    ``joint`` is the one to move, None for all of them. At ``faster`` times the speed of the training the parameter
    would be known well, None where speed does not show it better. The gain is that of knowing it exactly.
    """

    parameter: str
    value: float
    std: float
    share: float
    excitation: ExcitingMotion
    joint: str | None
    faster: float | None = None


@dataclass(frozen=True)
class SlowReversals(Step):
    """Record slow motion of the ``joints`` through zero speed, or smooth their Coulomb friction.

    ``speeds`` (rad/s, m/s): below them more is left than elsewhere. ``chosen``: friction and minimum speed are the
    best of those that were tried. The gain is that of leaving no more there.
    """

    joints: tuple[str, ...]
    speeds: tuple[float, ...] = ()
    chosen: bool = False


@dataclass(frozen=True)
class CheckRipple(Step):
    """Record constant speeds of the ``joints`` to see whether the ripple follows the position.

    The gain is that of a model of the whole ripple.
    """

    joints: tuple[str, ...]


@dataclass(frozen=True)
class SetRight(Step):
    """Set right what a ``finding`` of the checks says of the robot or its model: it gains as much as in training."""

    finding: Finding


@dataclass(frozen=True)
class HoldOutFaster(Step):
    """Record a held-out motion ``times`` as fast as the fastest is, which is as fast as the training: so the model is
    judged better."""

    times: float


@dataclass(frozen=True)
class LeaveOut(Step):
    """Leave these seconds, ``start`` to ``stop``, of a training ``log`` out: predicted from all others they leave a
    squared residual ``ratio`` times as large as the others do. The gain is cross-validated on these."""

    log: str
    start: float
    stop: float
    ratio: float


@dataclass(frozen=True)
class Cover(Step):
    """Record training motion in which a ``joint`` is ``faster`` times as fast as now, up to ``speed`` (rad/s, m/s).

    Held-out motion is beyond the speeds and accelerations of the training, above all from ``start`` to ``stop`` (s) of
    a ``log``. The gain is that of an error there as it is on the rest of that log.
    """

    log: str
    start: float
    stop: float
    joint: str
    faster: float
    speed: float
