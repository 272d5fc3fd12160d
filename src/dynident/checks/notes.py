"""What the checks find, as data: each note is the message of a ``Finding``, which has its severity and place.

``report/finding_words.py`` puts them into words, except those of ``ReadingNote``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynident.runtime import Note, Use


class ReadingNote(Note):
    """Base of notes that reading a log raises or warns of, below ``report``; their text is in ``checks/finding.py``."""


@dataclass(frozen=True)
class TooFewSamples(ReadingNote):
    """A log has fewer samples than the ``least`` number that can be smoothed; ``step`` (s) is their spacing."""

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
    """Equal spacing at a ``rate`` (Hz) is used instead of the stamps, whose steps have an rms ``jitter``.

    The positions are ``factor`` times less noisy on it; ``lost`` samples keep their place.
    """

    jitter: float
    factor: float
    rate: float
    lost: int


@dataclass(frozen=True)
class StampsJitter(Note):
    """The positions would be ``factor`` times less noisy with equal spacing.

    ``jitter`` is the rms jitter of the stamps. The remedy is the ``rate`` (Hz), or stamps rounded to multiples of
    ``step`` (s) where samples were lost: the other one is None.
    """

    jitter: float
    factor: float
    rate: float | None
    step: float | None


@dataclass(frozen=True)
class SamplingJitter(Note):
    """The time steps have an rms ``jitter``.

    Equal spacing makes positions ``factor`` times noisier, None where unclear.
    """

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
    """The gravity of a robot file (m/s^2), and the one that is used instead."""

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
    """A torque that opposes the nominal one, by its correlation.

    None where friction and inertia come out negative instead.
    """

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


@dataclass(frozen=True)
class ImpossibleInertia(Note):
    """How the inertia of a link violates physical consistency, in the words of ``consistency_violations``."""

    violation: str


@dataclass(frozen=True)
class NoMass(Note):
    """The links that a joint moves have no mass."""

    links: tuple[str, ...]


@dataclass(frozen=True)
class FloatingBase(Note):
    """A joint with several coordinates carries the whole robot, which is taken as fixed."""


@dataclass(frozen=True)
class SeveralLimbs(Note):
    """Several joints move limbs of a base with a mass, which is taken as fixed; it may be a trunk."""

    base: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class OnlyShapes(Note):
    """A link has shapes of files instead of an inertia."""


@dataclass(frozen=True)
class PointMass(Note):
    """A link has a mass (kg) without an inertia about its centre."""

    mass: float


@dataclass(frozen=True)
class FarCentre(Note):
    """The distance (m) of a centre of mass from its link's frame."""

    distance: float


@dataclass(frozen=True)
class LargeGyration(Note):
    """A largest moment (kg m^2) and its radius of gyration (m), large for the mass (kg) and size (m) of the link."""

    moment: float
    gyration: float
    mass: float
    size: float


@dataclass(frozen=True)
class InertiaAboutOrigin(Note):
    """The links whose inertias may be about the origins of their frames."""

    links: tuple[str, ...]


@dataclass(frozen=True)
class EqualLinks(Note):
    """Links with the same mass (kg) and moments; ``alone`` says that there are no others."""

    links: tuple[str, ...]
    mass: float
    alone: bool


@dataclass(frozen=True)
class OddTotalMass(Note):
    """A mass of all links (kg) that no arm has."""

    mass: float


@dataclass(frozen=True)
class EmptyRange(Note):
    """A lower limit of position that is not below the upper one (rad or m)."""

    lower: float
    upper: float


@dataclass(frozen=True)
class LimitNotPositive(Note):
    """A limit that is not positive: of "effort" or "velocity"."""

    quantity: str
    value: float


@dataclass(frozen=True)
class NoLimit(Note):
    """The joints without a limit of "effort" or "velocity"."""

    quantity: str
    joints: tuple[str, ...]
