"""Notes on a log beyond its time stamps: outliers, units, repeats, and what a motion cannot show."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from dynident.checks.notes import ReadingNote
from dynident.runtime import Note, Use


@dataclass(frozen=True)
class WrappedPosition(ReadingNote):
    """A position jumps ``count`` times by its whole range ``period`` (rad, m), first after sample ``row`` at ``time``
    (s)."""

    count: int
    period: float
    row: int
    time: float


@dataclass(frozen=True)
class WrongTimeUnit(ReadingNote):
    """A rate (Hz) and speed (rad/s, m/s) that no recording has.

    With the stamps multiplied by ``factor`` both would be plausible.
    """

    rate: float
    speed: float
    factor: float


@dataclass(frozen=True)
class PerhapsMillimetres(ReadingNote):
    """A sliding joint whose span (m) or speed (m/s) is larger than usual."""

    span: float
    speed: float


@dataclass(frozen=True)
class PositionSpikes(Note):
    """``count`` positions are spikes, the first at these ``rows`` and ``times`` (s), the ``largest`` in rad or m.

    They are ``replaced`` by what is around them, or kept.
    """

    count: int
    rows: tuple[int, ...]
    times: tuple[float, ...]
    largest: float
    replaced: bool


@dataclass(frozen=True)
class ManyPositionSpikes(PositionSpikes):
    """As ``PositionSpikes``, where they are too many to be replaced."""

    forbids: ClassVar[Use | None] = Use.CONTROL


@dataclass(frozen=True)
class FrozenPosition(Note):
    """A position is the same from sample ``row`` for ``count`` samples, from ``start`` to ``stop`` (s), and jumps."""

    row: int
    count: int
    start: float
    stop: float
    value: float
    replaced: bool


@dataclass(frozen=True)
class PositionJump(Note):
    """A position jumps by ``size`` (rad, m) after sample ``row`` at ``time`` (s), and stays; ``count`` times in all."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    count: int
    size: float
    row: int
    time: float


@dataclass(frozen=True)
class InterpolatedPositions(Note):
    """This ``share`` of the positions lies exactly on the line between their neighbours, while the joint moves."""

    share: float


@dataclass(frozen=True)
class TorqueSpikes(Note):
    """``count`` torques are spikes, the first at these ``rows`` and ``times`` (s), the ``largest`` in N m or N.

    They are ``masked`` in the fit, or kept; those of a ``held_out`` log are judged as measured.
    """

    count: int
    rows: tuple[int, ...]
    times: tuple[float, ...]
    largest: float
    masked: bool
    held_out: bool


@dataclass(frozen=True)
class ManyTorqueOutliers(Note):
    """The ``share`` of torques that look wrong is too large for outliers.

    The first is sample ``row`` at ``time`` (s).
    """

    forbids: ClassVar[Use | None] = Use.CONTROL
    share: float
    row: int
    time: float


@dataclass(frozen=True)
class FrozenTorque(Note):
    """A torque is the same from sample ``row`` for ``count`` samples, from ``start`` to ``stop`` (s), unlike the
    model's; ``masked`` and ``held_out`` as in ``TorqueSpikes``."""

    row: int
    count: int
    start: float
    stop: float
    value: float
    masked: bool
    held_out: bool


@dataclass(frozen=True)
class ClippedTorque(Note):
    """``count`` torques are exactly ``value``, where the model's is beyond it, first at sample ``row`` at ``time`` (s);
    ``masked`` and ``held_out`` as in ``TorqueSpikes``."""

    count: int
    value: float
    row: int
    time: float
    masked: bool
    held_out: bool


@dataclass(frozen=True)
class SameData(Note):
    """Two logs hold the same samples, in the ``other`` one ``lag`` (s) later, so that nothing is held out."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    other: str
    lag: float


@dataclass(frozen=True)
class RepeatedMotion(Note):
    """A held-out log repeats the motion of the ``other`` one, ``lag`` (s) later, with a difference of ``error`` %."""

    other: str
    lag: float
    error: float


@dataclass(frozen=True)
class PerhapsRadians(Note):
    """All positions multiplied by 180/pi explain the torque with an error of ``after`` % instead of ``before`` %."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    span: float
    before: float
    after: float


@dataclass(frozen=True)
class GravityCompensated(Note):
    """The torque contains the share ``factor`` +- ``std`` of the gravity of the inertias.

    ``before`` and ``after`` are the errors (%) of the fit with gravity and without.
    """

    forbids: ClassVar[Use | None] = Use.CONTROL
    factor: float
    std: float
    before: float
    after: float


@dataclass(frozen=True)
class NoFriction(Note):
    """Friction is at most ``share`` (%) of the torque of any joint."""

    share: float


@dataclass(frozen=True)
class SlowMotion(Note):
    """Accelerations explain only this ``share`` of the torque (%, of its rms), less than the ``residual`` of the fit
    (%); a motion ``faster`` by this factor would show inertias."""

    advises: ClassVar[bool] = True
    forbids: ClassVar[Use | None] = Use.SIMULATION
    share: float
    residual: float
    faster: float


@dataclass(frozen=True)
class FewReversals(Note):
    """The number of reversals of a joint."""

    count: int


@dataclass(frozen=True)
class HardlyMoves(Note):
    """The span of a joint in all of the training, and that of the joint that moves the most (rad or m).

    ``near`` is the middle of its positions.
    """

    span: float
    largest: float
    near: float
    unit: str


@dataclass(frozen=True)
class LoopDiffers(Note):
    """The share of a joint's torque by which its controller, at the measured motion, commands another one."""

    error: float


@dataclass(frozen=True)
class LoopGain(Note):
    """The measured torque is ``factor`` times what the controller commands.

    ``error`` and ``left`` are the differences between both without and with the factor, as shares of the torque.
    """

    factor: float
    error: float
    left: float


@dataclass(frozen=True)
class LoopUnused(Note):
    """Columns that are named as reference positions but used by no controller."""

    columns: tuple[str, ...]


@dataclass(frozen=True)
class LoopVelocity(Note):
    """The number of steps over which drives difference positions: as ``given``, and as it fits the measured torque.

    ``error`` and ``left`` are the shares of the torque that do not fit with the given and with the fitted number;
    zero steps where the drives are faster than they are said to be.
    """

    given: int
    steps: int
    error: float
    left: float


@dataclass(frozen=True)
class PositionBeyondLimits(Note):
    """The range of a position, and the one that the robot file allows (rad or m).

    ``far`` beyond it the position is a motor's.
    """

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
    """A peak torque and its limit in the robot file, in ``unit``.

    ``far`` above it the torque is another quantity or unit.
    """

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


class SearchKind(StrEnum):
    """Kinds of searches that are skipped in a model of many joints."""

    FITS = "whatever needs a fit"
    CAUSES = "what explains the residual"
    PAIRS = "exchanged columns of joints that are no neighbours"


@dataclass(frozen=True)
class SearchLeftOut(Note):
    """A search that was skipped because the model has so many joints and parameters."""

    search: SearchKind
    joints: int
    parameters: int
