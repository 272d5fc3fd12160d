"""Notes on stamps, channels, torques and the robot file: each is the message of a ``Finding``."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10
from typing import ClassVar

from dynident.runtime import Note, Remark, Use, count, instant, join_names, percent, short

MAX_SAMPLE_INTERVAL = 0.15  # s: samples further apart may be stamped in another unit
FROM_CAD = "Take it from CAD, or identify it with `kind: consistent`."


class Unread(Remark):
    """What is in a robot file and was not read."""

    topic = "unread"


class Unusable(Remark):
    """Why a file cannot be checked."""

    topic = "unusable"


class NotSmoothed(Remark):
    """Why the motion of the recordings could not be found or fitted."""

    topic = "motion"


@dataclass(frozen=True)
class TooFewSamples(Note):
    """A log has fewer samples than the ``least`` number that can be smoothed; ``step`` (s) is their spacing."""

    topic = "samples"
    samples: int
    least: int
    step: float = 0.0

    def __str__(self) -> str:
        count = "one sample" if self.samples == 1 else f"{self.samples} samples"
        spacing, remedy = "", "widen the window or record longer."
        if self.step > MAX_SAMPLE_INTERVAL:
            spacing, remedy = f", {self.step:.3g} s apart", f"is the `unit` of `time` right? Else {remedy}"
        return f"only {count}{spacing}; at least {self.least} are needed: {remedy}"


@dataclass(frozen=True)
class LongGap(Note):
    """The first of ``count`` gaps: its length (s), the time (s) before it, and its length over the median step."""

    topic = "gap"
    length: float
    after: float
    ratio: float
    count: int

    def __str__(self) -> str:
        number_of_gaps = "the only one" if self.count == 1 else f"{self.count} such gaps in all"
        return (
            f"a gap of {self.length:.4g} s after t = {instant(self.after)} s ({self.ratio:.0f} times the median step; "
            f"{number_of_gaps}). Leave it out with a window, or set `gaps: split` to smooth each piece separately."
        )


@dataclass(frozen=True)
class UnevenSteps(Note):
    """The time steps vary: rms ``jitter`` over the median ``step`` (s), ``shortest`` and ``longest`` step (s)."""

    topic = "jitter"
    jitter: float
    step: float
    shortest: float
    longest: float

    def __str__(self) -> str:
        return (
            f"the time steps vary by {100 * self.jitter:.0f} % about {self.step:.4g} s (from {self.shortest:.3g} to "
            f"{self.longest:.3g} s). Where the clock of the stamps is not that of the sampling, this acts as position "
            "noise."
        )


@dataclass(frozen=True)
class NeverMoves(Note):
    """A position has at most three distinct values, the first of them ``near`` (rad or m)."""

    topic = "still"
    levels: int
    near: float

    def __str__(self) -> str:
        values = "one value" if self.levels == 1 else f"{self.levels} distinct values"
        return (
            f"the position never moves ({values} near {self.near:.6g}): nothing about this joint's own motion can be "
            "identified. Check that the right column is named, or use another window; a joint of a robot file that "
            "is to stand still goes under `model.lock`."
        )


@dataclass(frozen=True)
class PerhapsDegrees(Note):
    """A position spans more rad, or reaches more rad/s, than a robot arm does."""

    topic = "degrees"
    span: float
    speed: float

    def __str__(self) -> str:
        return (
            f"the position spans {self.span:.4g} rad at up to {self.speed:.4g} rad/s, more than a robot arm does; is "
            "it in degrees? Set `unit: deg`, or `multi_turn: true` in the joint's position channel if it does turn "
            "that far."
        )


@dataclass(frozen=True)
class QuantisedPosition(Note):
    """Most samples of a position differ by fewer than ``counts`` steps of ``resolution`` (rad or m)."""

    topic = "quantised"
    resolution: float
    counts: float

    def __str__(self) -> str:
        return (
            f"the position is quantised in steps of {self.resolution:.4g}, and most samples differ by fewer than "
            f"{self.counts:.0f} of them: the error is not white noise, so do not rely on a noise level estimated from "
            "it."
        )


@dataclass(frozen=True)
class ConstantTorque(Note):
    """A torque (N m or N) is the same throughout."""

    topic = "dead"
    value: float

    def __str__(self) -> str:
        return (
            f"the torque is {self.value:.6g} throughout; check that the right column is named and was recorded. The "
            "fit leaves its equation out, unless the other joints show that the joint turns freely."
        )


@dataclass(frozen=True)
class ArmAtRest(Note):
    """The whole arm is at rest between two times (s), which is ``kept`` in the fit or not."""

    topic = "rest"
    start: float
    stop: float
    kept: bool = True

    def __str__(self) -> str:
        digits = max(0, 1 - floor(log10(max(self.stop - self.start, 1e-9))))
        remedy = "At the ends of a log this is left out, and within it where that predicts the torque in motion better."
        if self.kept:
            remedy = "Set `rests: trim`, `min_speed`, or a window without this part."
        return (
            f"the arm is at rest from {self.start:.{digits}f} to {self.stop:.{digits}f} s: static friction there can "
            f"take any value up to its limit. {remedy}"
        )


@dataclass(frozen=True)
class EquallySpaced(Note):
    """Equal spacing at a ``rate`` (Hz) is used instead of the stamps, whose steps have an rms ``jitter``.

    The positions are ``factor`` times less noisy on it; ``lost`` samples keep their place.
    """

    jitter: float
    factor: float
    rate: float
    lost: int

    def __str__(self) -> str:
        lost = f", {self.lost} lost samples left open" if self.lost else ""
        noise = f"{self.factor:.3g} times less" if self.factor >= 1 else f"{1 / self.factor:.3g} times more"
        return (
            f"samples are taken as equally spaced, at {self.rate:.6g} Hz{lost}: the steps of the stamps vary by "
            f"{100 * self.jitter:.2g} %, and the positions are {noise} noisy. `time: {{ spacing: stamps }}` undoes it."
        )


@dataclass(frozen=True)
class StampsJitter(Note):
    """The positions would be ``factor`` times less noisy with equal spacing.

    ``jitter`` is the rms jitter of the stamps. The remedy is the ``rate`` (Hz), or stamps rounded to multiples of
    ``step`` (s) where samples were lost: the other one is None.
    """

    topic = "stamps"
    jitter: float
    factor: float
    rate: float | None
    step: float | None

    def __str__(self) -> str:
        if self.step is None:
            remedy = f"Set `time: {{ rate: {self.rate:.6g} }}` instead of the column, and compare the held-out error"
        else:
            remedy = f"Round the stamps to multiples of {self.step:.6g} s in the file"
        return (
            f"{_vary(self.jitter)} would be {_times(self.factor)} less noisy with equal spacing: the sampling is "
            f"regular and the stamps are not. {remedy}."
        )


@dataclass(frozen=True)
class SamplingJitter(Note):
    """The time steps have an rms ``jitter``.

    Equal spacing makes positions ``factor`` times noisier, None where unclear.
    """

    topic = "jitter"
    jitter: float
    factor: float | None

    def __str__(self) -> str:
        axis = "do not show whether the stamps or the sampling jitter"
        if self.factor is not None:
            axis = f"would be {_times(self.factor)} noisier with equal spacing: the sampling itself jitters"
        return (
            f"{_vary(self.jitter)} {axis}. Keep the stamps, and use the spline smoother, which needs no equal spacing."
        )


@dataclass(frozen=True)
class LostSamples(Note):
    """Samples missing between the others, their share of all, and the longest step over the median."""

    topic = "lost"
    count: int
    share: float
    longest: float

    def __str__(self) -> str:
        return (
            f"about {count(self.count, 'sample')} ({percent(100 * self.share, 2)}) "
            f"{'is' if self.count == 1 else 'are'} lost, in steps of up to {self.longest:.0f} times the median: a "
            "spline bridges them if the time is taken from the stamps and not from a `rate`."
        )


@dataclass(frozen=True)
class RepeatedPositions(Note):
    """Share of positions that repeat the previous one in motion; about one in ``every`` is new, 0 where none is."""

    topic = "stale"
    share: float
    every: int

    def __str__(self) -> str:
        remedy = "Drop the repeated rows if the torque repeats as well; else choose the smoothing with `rule: torque`."
        if self.every > 1:
            remedy = f"Keep only one row in {self.every}, the first with each new value."
        return (
            f"{percent(100 * self.share, 2)} of the positions exactly repeat the previous one although the joint "
            f"moves: the encoder is read less often than it is logged. {remedy}"
        )


@dataclass(frozen=True)
class GravityIgnored(Note):
    """The gravity of a robot file (m/s^2), and the one that is used instead."""

    topic = "gravity"
    given: tuple[float, ...]
    used: tuple[float, ...]

    def __str__(self) -> str:
        return (
            f"the file's gravity {self.given} is ignored; {self.used} m/s^2 is used. Set `gravity` if the arm is "
            "mounted that way."
        )


@dataclass(frozen=True)
class OtherGravity(Note):
    """The gravity that the torques fit and the one assumed (m/s^2, in the root link's frame)."""

    topic = "gravity"
    forbids: ClassVar[Use | None] = Use.CONTROL
    fitted: tuple[float, ...]
    assumed: tuple[float, ...]

    def __str__(self) -> str:
        estimated, assumed = (
            ", ".join(f"{x:{form}}" for x in g) for g, form in ((self.fitted, ".1f"), (self.assumed, ".4g"))
        )
        return (
            f"is gravity right? The torques fit a gravity of about ({estimated}) m/s^2 in the root link's frame, not "
            f"({assumed}). Set `gravity` if the arm is mounted that way; otherwise check the signs of all torques and "
            "positions, and `zero`."
        )


@dataclass(frozen=True)
class ReversedSign(Note):
    """A torque that opposes the nominal one, by its correlation.

    None where friction and inertia come out negative instead.
    """

    topic = "sign"
    forbids: ClassVar[Use | None] = Use.CONTROL
    correlation: float | None

    def __str__(self) -> str:
        why = "friction and inertia of the joint are estimated as negative"
        if self.correlation is not None:
            why = f"it opposes the torque of the robot file's inertias (correlation {self.correlation:z.2f})"
        return (
            f"is the sign of the torque reversed? In this motion {why}. Check the signs of `gain` and `transmission`, "
            "and that position and torque have the same positive direction."
        )


@dataclass(frozen=True)
class OddScale(Note):
    """A torque of ``scale`` times the nominal one, which should be in ``unit``."""

    topic = "scale"
    forbids: ClassVar[Use | None] = Use.CONTROL
    scale: float
    unit: str

    def __str__(self) -> str:
        return (
            f"the torque is {short(self.scale)} times that of the robot file's inertias. Is a gear ratio, a torque "
            f"constant or a unit missing in `gain`? It should be in {self.unit}."
        )


@dataclass(frozen=True)
class UnrelatedTorque(Note):
    """A torque that hardly correlates with the nominal one, which is ``ratio`` times as large."""

    topic = "foreign"
    forbids: ClassVar[Use | None] = Use.CONTROL
    ratio: float
    correlation: float

    def __str__(self) -> str:
        return (
            "does this torque belong to this joint? It hardly correlates with the torque of the robot file's "
            f"inertias, which is {short(self.ratio, 2)} times as large (correlation {self.correlation:z.2f}). Check "
            "the column."
        )


@dataclass(frozen=True)
class ImpossibleInertia(Note):
    """How the inertia of a link violates physical consistency, in the words of ``consistency_violations``."""

    topic = "impossible"
    violation: str

    def __str__(self) -> str:
        return f"{self.violation}. No body can have such an inertia. {FROM_CAD}"


@dataclass(frozen=True)
class NoMass(Note):
    """The links that a joint moves have no mass."""

    topic = "massless"
    links: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"the links that the joint moves ({', '.join(self.links)}) have no mass in the file: simulators reject "
            f"this, and it gives no prior. {FROM_CAD}"
        )


@dataclass(frozen=True)
class FloatingBase(Note):
    """A joint with several coordinates carries the whole robot, which is taken as fixed."""

    topic = "floating"

    def __str__(self) -> str:
        return (
            "it lets the whole robot float or drive, but only a fixed base is supported: it is taken as fixed. "
            "Record with the base clamped, as what it feels of a moving one is not modelled."
        )


@dataclass(frozen=True)
class SeveralLimbs(Note):
    """Several joints move limbs of a base with a mass, which is taken as fixed; it may be a trunk."""

    topic = "limbs"
    base: str
    joints: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"{len(self.joints)} limbs move from the base {self.base!r}, which is taken as fixed "
            f"({join_names(self.joints, 4)}): right for arms on a stand; a walking robot must be clamped at its trunk."
        )


@dataclass(frozen=True)
class OnlyShapes(Note):
    """A link has shapes of files instead of an inertia."""

    topic = "shapes"

    def __str__(self) -> str:
        return (
            "its inertia follows from meshes or height fields, which are not read; save the compiled model from "
            "MuJoCo with <compiler saveinertial='true'/>, which writes the inertia out."
        )


@dataclass(frozen=True)
class PointMass(Note):
    """A link has a mass (kg) without an inertia about its centre."""

    topic = "point"
    mass: float

    def __str__(self) -> str:
        return (
            f"{short(self.mass, 4)} kg without an inertia about the centre of mass: a point mass, or an inertia "
            "rounded to zero."
        )


@dataclass(frozen=True)
class FarCentre(Note):
    """The distance (m) of a centre of mass from its link's frame."""

    topic = "far"
    distance: float

    def __str__(self) -> str:
        return (
            f"its centre of mass is {short(self.distance, 4)} m from its frame. Is it in millimetres, or in another "
            "frame? A URDF gives metres in the link's own frame."
        )


@dataclass(frozen=True)
class LargeGyration(Note):
    """A largest moment (kg m^2) and its radius of gyration (m), large for the mass (kg) and size (m) of the link."""

    topic = "spread"
    moment: float
    gyration: float
    mass: float
    size: float

    def __str__(self) -> str:
        return (
            f"its largest moment {short(self.moment)} kg m^2 means a radius of gyration of {short(self.gyration, 2)} "
            f"m for its {short(self.mass)} kg, on a link of about {short(self.size, 2)} m. Is it about another point, "
            "or a placeholder? It would be a misleading prior."
        )


@dataclass(frozen=True)
class InertiaAboutOrigin(Note):
    """The links whose inertias may be about the origins of their frames."""

    topic = "about origin"
    links: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"the inertias of {', '.join(self.links)} are as large as if they were about the origins of the links' "
            "frames. A robot file gives them about the centre of mass; if that was overlooked, subtract m c^2 "
            "(parallel axes)."
        )


@dataclass(frozen=True)
class EqualLinks(Note):
    """Links with the same mass (kg) and moments; ``alone`` says that there are no others."""

    topic = "copied"
    links: tuple[str, ...]
    mass: float
    alone: bool

    def __str__(self) -> str:
        description = f"have the same mass {short(self.mass, 4)} kg and the same moments:"
        if self.alone:
            return f"all links {description} placeholders? {FROM_CAD}"
        return f"{', '.join(self.links)} {description} copied, or simple shapes? They are a weak prior."


@dataclass(frozen=True)
class OddTotalMass(Note):
    """A mass of all links (kg) that no arm has."""

    topic = "total mass"
    mass: float

    def __str__(self) -> str:
        return f"the total mass of all links is {short(self.mass, 4)} kg. Are the masses in kg?"


@dataclass(frozen=True)
class EmptyRange(Note):
    """A lower limit of position that is not below the upper one (rad or m)."""

    topic = "limits"
    lower: float
    upper: float

    def __str__(self) -> str:
        return (
            f"its lower limit {self.lower:g} is not below its upper limit {self.upper:g}: simulators use it as given. "
            "Correct it."
        )


@dataclass(frozen=True)
class LimitNotPositive(Note):
    """A limit that is not positive: of "effort" or "velocity"."""

    topic = "limits"
    quantity: str
    value: float

    def __str__(self) -> str:
        return f"its {self.quantity} limit is {self.value:g}: simulators use it as given. Correct it."


@dataclass(frozen=True)
class NoLimit(Note):
    """The joints without a limit of "effort" or "velocity"."""

    topic = "limits"
    quantity: str
    joints: tuple[str, ...]

    def __str__(self) -> str:
        return f"no {self.quantity} limit for {', '.join(self.joints)}: recordings cannot be checked against it."


def _vary(jitter: float) -> str:
    return f"the time steps vary by {percent(100 * jitter, 2)} rms, and the positions"


def _times(factor: float) -> str:
    if factor > 1000:
        return "over 1000 times"
    return f"{short(factor)} times" if factor >= 2 else f"{100 * (factor - 1):.0f} %"
