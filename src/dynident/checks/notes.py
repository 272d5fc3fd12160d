"""What the checks find, as data: each is the message of a ``Finding``, which has its severity and place.

``report/finding_words.py`` puts them into words, except those of ``ReadingNote``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynident.errors import Note, Use

__all__ = [
    "ArmAtRest",
    "ConstantTorque",
    "EquallySpaced",
    "GravityIgnored",
    "LongGap",
    "LostSamples",
    "NeverMoves",
    "OddScale",
    "OtherGravity",
    "PerhapsDegrees",
    "QuantisedPosition",
    "ReadingNote",
    "RepeatedPositions",
    "ReversedSign",
    "SamplingJitter",
    "StampsJitter",
    "TooFewSamples",
    "UnevenSteps",
    "UnrelatedTorque",
]


class ReadingNote(Note):
    """Base of what reading a log raises or warns of, below ``report``; its words are in ``checks/reading.py``."""


@dataclass(frozen=True)
class TooFewSamples(ReadingNote):
    """A log has fewer samples than ``least``, which can be smoothed; ``step`` (s) is what they are apart."""

    samples: int
    least: int
    step: float = 0.0


@dataclass(frozen=True)
class LongGap(ReadingNote):
    """The first of ``count`` gaps: its length (s), the time (s) before it, and its length over the median step."""

    length: float
    after: float
    ratio: float
    count: int


@dataclass(frozen=True)
class UnevenSteps(ReadingNote):
    """The time steps vary: rms ``jitter`` over the median ``step`` (s), ``shortest`` and ``longest`` step (s)."""

    jitter: float
    step: float
    shortest: float
    longest: float


@dataclass(frozen=True)
class NeverMoves(ReadingNote):
    """A position has at most three distinct values, the first of them ``near`` (rad or m)."""

    levels: int
    near: float


@dataclass(frozen=True)
class PerhapsDegrees(ReadingNote):
    """A position spans more rad, or reaches more rad/s, than a robot arm does."""

    span: float
    speed: float


@dataclass(frozen=True)
class QuantisedPosition(ReadingNote):
    """Most samples of a position differ by fewer than ``counts`` steps of ``resolution`` (rad or m)."""

    resolution: float
    counts: float


@dataclass(frozen=True)
class ConstantTorque(ReadingNote):
    """A torque (N m or N) is the same throughout."""

    value: float


@dataclass(frozen=True)
class ArmAtRest(ReadingNote):
    """The whole arm is at rest between two times (s), which is ``kept`` in the fit or not."""

    start: float
    stop: float
    kept: bool = True


@dataclass(frozen=True)
class EquallySpaced(ReadingNote):
    """Equal spacing is used, at a ``rate`` (Hz), and not the stamps, whose steps vary by rms ``jitter``.

    The positions are ``factor`` times less noisy on it; so many ``lost`` samples keep their place.
    """

    jitter: float
    factor: float
    rate: float
    lost: int


@dataclass(frozen=True)
class StampsJitter(Note):
    """The positions would be ``factor`` times less noisy with equal spacing, the stamps' rms jitter being ``jitter``.

    The remedy is the ``rate`` (Hz), or stamps rounded to multiples of ``step`` (s) where samples were lost: the other
    is None.
    """

    jitter: float
    factor: float
    rate: float | None
    step: float | None


@dataclass(frozen=True)
class SamplingJitter(Note):
    """The time steps vary by rms ``jitter``; equal spacing makes positions ``factor`` times noisier, None: unclear."""

    jitter: float
    factor: float | None


@dataclass(frozen=True)
class LostSamples(Note):
    """Samples missing between the others, their share of all, and the longest step over the median."""

    count: int
    share: float
    longest: float


@dataclass(frozen=True)
class RepeatedPositions(Note):
    """Share of positions that repeat the previous one in motion; about one in ``every`` is new, 0 where none is."""

    share: float
    every: int


@dataclass(frozen=True)
class GravityIgnored(Note):
    """The gravity of a robot file (m/s^2) and another one that is used instead."""

    given: tuple[float, ...]
    used: tuple[float, ...]


@dataclass(frozen=True)
class OtherGravity(Note):
    """The gravity that the torques fit and the one assumed (m/s^2, in the root link's frame)."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    fitted: tuple[float, ...]
    assumed: tuple[float, ...]


@dataclass(frozen=True)
class ReversedSign(Note):
    """A torque that opposes the nominal one, by its correlation; None: friction and inertia come out negative."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    correlation: float | None


@dataclass(frozen=True)
class OddScale(Note):
    """A torque of ``scale`` times the nominal one, which should be in ``unit``."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    scale: float
    unit: str


@dataclass(frozen=True)
class UnrelatedTorque(Note):
    """A torque that hardly correlates with the nominal one, which is ``ratio`` times as large."""

    forbids: ClassVar[Use | None] = Use.CONTROL
    ratio: float
    correlation: float
