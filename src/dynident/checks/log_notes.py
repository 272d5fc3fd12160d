"""What the checks find in a log beyond its stamps, as data: outliers, units, repeats, and what a motion cannot show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynident.checks.notes import ReadingNote
from dynident.errors import Note, Use

__all__ = [
    "ClippedTorque",
    "FrozenPosition",
    "FrozenTorque",
    "GravityCompensated",
    "InterpolatedPositions",
    "ManyPositionSpikes",
    "ManyTorqueOutliers",
    "NoFriction",
    "PerhapsMillimetres",
    "PerhapsRadians",
    "PositionJump",
    "PositionSpikes",
    "RepeatedMotion",
    "SameData",
    "SlowMotion",
    "TorqueSpikes",
    "WrappedPosition",
    "WrongTimeUnit",
]


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
    """A rate (Hz) and speed (rad/s, m/s) that no recording has; stamps multiplied by ``factor`` would be usual."""

    rate: float
    speed: float
    factor: float


@dataclass(frozen=True)
class PerhapsMillimetres(ReadingNote):
    """A sliding joint that moves further, or faster, than one does: span (m) and speed (m/s)."""

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
    """The same where they are too many to be replaced."""

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
    """This ``share`` of the torques looks wrong, too much to be outliers, first at sample ``row`` at ``time`` (s)."""

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
    """Two logs hold the same samples, the ``other`` ones ``lag`` (s) later, so that nothing is held out."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    other: str
    lag: float


@dataclass(frozen=True)
class RepeatedMotion(Note):
    """A held-out log repeats the motion of the ``other``, ``lag`` (s) later, with a difference of ``error`` %."""

    other: str
    lag: float
    error: float


@dataclass(frozen=True)
class PerhapsRadians(Note):
    """All positions multiplied by 180/pi explain the torque with ``after`` % of error instead of ``before``."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    span: float
    before: float
    after: float


@dataclass(frozen=True)
class GravityCompensated(Note):
    """The torque shows the share ``factor`` +- ``std`` of the gravity that the inertias have; errors (%) of the fit
    with gravity and without."""

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
