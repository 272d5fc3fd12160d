"""Notes on a log beyond its time stamps: outliers, units, repeats, and what a motion cannot show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from dynident.runtime import Note, Use, WordedEnum, count, instant, join_names, percent, short

CABLE = "Look for a loose cable, a lost message, or a full buffer where it was recorded."
ASTRAY = "What is found by simulating the loop is wrong by more than its errors say."


@dataclass(frozen=True)
class WrappedPosition(Note):
    """A position jumps ``count`` times by its whole range ``period`` (rad, m), first after sample ``row`` at ``time``
    (s)."""

    topic = "wrapped"
    count: int
    period: float
    row: int
    time: float

    def __str__(self) -> str:
        times = "once" if self.count == 1 else f"{self.count} times"
        return (
            f"the position wraps: it jumps {times} by {self.period:.5g} rad, its whole range, first after sample "
            f"{self.row} (t = {instant(self.time)} s). Set `wraps` in its position channel: the value at which the "
            "column starts anew, such as 360 for degrees or 6.283185307179586 for rad."
        )


@dataclass(frozen=True)
class WrongTimeUnit(Note):
    """A rate (Hz) and speed (rad/s, m/s) that no recording has.

    With the stamps multiplied by ``factor`` both would be plausible.
    """

    topic = "time unit"
    rate: float
    speed: float
    factor: float

    def __str__(self) -> str:
        units = {1e-3: "ms", 1e-6: "us", 1e-9: "ns"}
        if self.factor < 1:
            remedy = f"are the stamps in {units[self.factor]} and declared as s? Set `unit: {units[self.factor]}`"
        else:
            unit = units[1 / self.factor]
            remedy = f"are the stamps in s and declared as {unit}? Set `unit: s`"
        return (
            f"a rate of {self.rate:.3g} Hz with speeds up to {self.speed:.3g} rad/s or m/s is not that of a robot; "
            f"with stamps multiplied by {self.factor:g} both would be usual: {remedy}."
        )


@dataclass(frozen=True)
class PerhapsMillimetres(Note):
    """A sliding joint whose span (m) or speed (m/s) is larger than usual."""

    topic = "millimetres"
    span: float
    speed: float

    def __str__(self) -> str:
        return (
            f"the position spans {self.span:.4g} m at up to {self.speed:.4g} m/s, more than a sliding joint does; is "
            "it in millimetres? Set `unit: mm`."
        )


@dataclass(frozen=True)
class PositionSpikes(Note):
    """``count`` positions are spikes, the first at these ``rows`` and ``times`` (s), the ``largest`` in rad or m.

    They are ``replaced`` by what is around them, or kept.
    """

    topic = "position spikes"
    count: int
    rows: tuple[int, ...]
    times: tuple[float, ...]
    largest: float
    replaced: bool

    def __str__(self) -> str:
        return (
            f"{count(self.count, 'position')} {'stands' if self.count == 1 else 'stand'} out by up to "
            f"{short(self.largest)}: {_at(self.rows, self.times, self.count)}. "
            f"{_replacement_clause(self.replaced, self.count)} {CABLE}"
        )

    @property
    def figures(self) -> str:
        """Its size and rows."""
        return f"{self.count} by up to {short(self.largest, 4)}, {_at(self.rows, self.times, self.count)}"


@dataclass(frozen=True)
class ManyPositionSpikes(PositionSpikes):
    """As ``PositionSpikes``, where they are too many to be replaced."""

    forbids: ClassVar[Use | None] = Use.CONTROL

    def __str__(self) -> str:
        return (
            f"{self.count} positions stand out by up to {short(self.largest)}, too many to be replaced: "
            f"{_at(self.rows, self.times, self.count)}. Correct them in the file. {CABLE}"
        )


@dataclass(frozen=True)
class FrozenPosition(Note):
    """A position is the same from sample ``row`` for ``count`` samples, from ``start`` to ``stop`` (s), and jumps."""

    topic = "frozen position"
    row: int
    count: int
    start: float
    stop: float
    value: float
    replaced: bool

    def __str__(self) -> str:
        return (
            f"the position is {self.value:.6g} for {self.count} samples, from sample {self.row} (t = "
            f"{instant(self.start)} s) to t = {instant(self.stop)} s, and jumps: it was not read there. "
            f"{_replacement_clause(self.replaced)} {CABLE}"
        )

    @property
    def figures(self) -> str:
        """Its size and rows."""
        return f"{self.count} samples at {self.value:.6g} from sample {self.row}"


@dataclass(frozen=True)
class PositionJump(Note):
    """A position jumps by ``size`` (rad, m) after sample ``row`` at ``time`` (s), and stays; ``count`` times in all."""

    topic = "jump"
    forbids: ClassVar[Use | None] = Use.CONTROL
    count: int
    size: float
    row: int
    time: float

    def __str__(self) -> str:
        repeats = "once more" if self.count == 2 else f"{self.count - 1} more times"
        suffix = f", and {repeats}" if self.count > 1 else ""
        return (
            f"the position jumps by {short(self.size, 4)} after sample {self.row} (t = {instant(self.time)} "
            f"s){suffix}: are two recordings joined, or did the encoder lose counts? Give the pieces as separate "
            "logs, by windows."
        )

    @property
    def figures(self) -> str:
        """Its size and rows."""
        return f"by {short(self.size, 4)} after sample {self.row}"


@dataclass(frozen=True)
class InterpolatedPositions(Note):
    """This ``share`` of the positions lies exactly on the line between their neighbours, while the joint moves."""

    topic = "interpolated"
    share: float

    def __str__(self) -> str:
        return (
            f"{percent(100 * self.share, 2)} of the positions lie exactly on the line between their neighbours: they "
            "were interpolated from fewer samples, which adds no knowledge and spoils accelerations. Log at the rate "
            "of the encoder, or keep only its own samples."
        )


@dataclass(frozen=True)
class TorqueSpikes(Note):
    """``count`` torques are spikes, the first at these ``rows`` and ``times`` (s), the ``largest`` in N m or N.

    They are ``masked`` in the fit, or kept; those of a ``held_out`` log are judged as measured.
    """

    topic = "torque spikes"
    count: int
    rows: tuple[int, ...]
    times: tuple[float, ...]
    largest: float
    masked: bool
    held_out: bool

    def __str__(self) -> str:
        return (
            f"{count(self.count, 'torque')} {'stands' if self.count == 1 else 'stand'} out by up to "
            f"{short(self.largest, 4)}, unlike the motion: {_at(self.rows, self.times, self.count)}. "
            f"{_fit_clause(self.masked, self.held_out, self.count)} {CABLE}"
        )

    @property
    def figures(self) -> str:
        """Its size and rows."""
        return f"{self.count} by up to {short(self.largest, 4)}, {_at(self.rows, self.times, self.count)}"


@dataclass(frozen=True)
class ManyTorqueOutliers(Note):
    """The ``share`` of torques that look wrong is too large for outliers.

    The first is sample ``row`` at ``time`` (s).
    """

    topic = "many outliers"
    forbids: ClassVar[Use | None] = Use.CONTROL
    share: float
    row: int
    time: float

    def __str__(self) -> str:
        return (
            f"{percent(100 * self.share, 2)} of the torques look like outliers, first sample {self.row} (t = "
            f"{instant(self.time)} s): too many to be left out, so that none is. Is it the right column, or was it "
            "recorded badly?"
        )


@dataclass(frozen=True)
class FrozenTorque(Note):
    """A torque is the same from sample ``row`` for ``count`` samples, from ``start`` to ``stop`` (s), unlike the
    model's; ``masked`` and ``held_out`` as in ``TorqueSpikes``."""

    topic = "frozen torque"
    row: int
    count: int
    start: float
    stop: float
    value: float
    masked: bool
    held_out: bool

    def __str__(self) -> str:
        level = "zero" if self.value == 0 else f"{self.value:.6g}"
        return (
            f"the torque is {level} for {self.count} samples, from sample {self.row} (t = {instant(self.start)} s) to "
            f"t = {instant(self.stop)} s, though the motion needs another: it was not read there, or the drive was "
            f"off. {_fit_clause(self.masked, self.held_out)} {CABLE}"
        )

    @property
    def figures(self) -> str:
        """Its size and rows."""
        return f"{self.count} samples at {self.value:.6g} from sample {self.row}"


@dataclass(frozen=True)
class ClippedTorque(Note):
    """``count`` torques are exactly ``value``, where the model's is beyond it, first at sample ``row`` at ``time`` (s);
    ``masked`` and ``held_out`` as in ``TorqueSpikes``."""

    topic = "clipped"
    count: int
    value: float
    row: int
    time: float
    masked: bool
    held_out: bool

    def __str__(self) -> str:
        return (
            f"{self.count} torques are exactly {self.value:.6g}, first sample {self.row} (t = {instant(self.time)} "
            "s), where the motion needs more: the sensor or the signal is at its limit. "
            f"{_fit_clause(self.masked, self.held_out)} Record with a larger range, or a gentler motion."
        )

    @property
    def figures(self) -> str:
        """Its size and rows."""
        return f"{self.count} at {self.value:.6g}, first sample {self.row}"


@dataclass(frozen=True)
class SameData(Note):
    """Two logs hold the same samples, in the ``other`` one ``lag`` (s) later, so that nothing is held out."""

    topic = "repeat"
    forbids: ClassVar[Use | None] = Use.CONTROL
    other: str
    lag: float

    def __str__(self) -> str:
        return (
            f"holds the same samples as {self.other!r} of the training{_lag_clause(self.lag, 1e-6)}: nothing is held "
            "out, and its error says nothing. Give another recording for validation."
        )


@dataclass(frozen=True)
class RepeatedMotion(Note):
    """A held-out log repeats the motion of the ``other`` one, ``lag`` (s) later, with a difference of ``error`` %."""

    topic = "repeat"
    other: str
    lag: float
    error: float

    def __str__(self) -> str:
        return (
            f"repeats the motion of {self.other!r}{_lag_clause(self.lag, 1e-3)}, to {percent(self.error, 2)}: its "
            "error shows repeatability, not how the model does on another motion. Hold out a different motion. "
            "(Repeats at another speed are not looked for.)"
        )


@dataclass(frozen=True)
class PerhapsRadians(Note):
    """All positions multiplied by 180/pi explain the torque with an error of ``after`` % instead of ``before`` %."""

    topic = "radians"
    forbids: ClassVar[Use | None] = Use.CONTROL
    span: float
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"no joint moves more than {short(self.span, 2)} rad; as degrees that should have been radians, the "
            f"positions leave {percent(self.after)} of the torque unexplained instead of {percent(self.before)}. Are "
            "they in rad? Set `unit: rad`."
        )


@dataclass(frozen=True)
class GravityCompensated(Note):
    """The torque contains the share ``factor`` +- ``std`` of the gravity of the inertias.

    ``before`` and ``after`` are the errors (%) of the fit with gravity and without.
    """

    topic = "gravity compensated"
    forbids: ClassVar[Use | None] = Use.CONTROL
    factor: float
    std: float
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"the torque shows {self.factor:z.2f} +- {short(self.std, 2)} times the gravity of the arm: without it "
            f"the plain fit leaves {percent(self.after)} instead of {percent(self.before)}. Was it logged after "
            "gravity compensation, or is the arm mounted so that gravity does not act? Log the whole torque, add the "
            "compensation to it by `sum`, or set `gravity: [0, 0, 0]` for a model without gravity."
        )


@dataclass(frozen=True)
class NoFriction(Note):
    """Friction is at most ``share`` (%) of the torque of any joint."""

    topic = "friction"
    share: float

    def __str__(self) -> str:
        return (
            f"the torque shows almost no friction: at most {percent(self.share, 2)} of any joint's. Was it logged "
            "after friction compensation, measured behind the gears, or simulated without friction? The model then "
            "gives the torque of the links: for feedforward, add the friction of the drives."
        )


@dataclass(frozen=True)
class SlowMotion(Note):
    """Accelerations explain only this ``share`` of the torque (%, of its rms), less than the ``residual`` of the fit
    (%); a motion ``faster`` by this factor would show inertias."""

    topic = "slow"
    advises: ClassVar[bool] = True
    forbids: ClassVar[Use | None] = Use.SIMULATION
    share: float
    residual: float
    faster: float

    def __str__(self) -> str:
        return (
            f"accelerations explain only {percent(self.share, 2)} of the torque, less than the "
            f"{percent(self.residual, 2)} that the fit leaves: the motion is too slow to show inertias, and faster "
            f"motion would not be predicted. Record one at least {short(self.faster, 2)} times as fast."
        )


@dataclass(frozen=True)
class FewReversals(Note):
    """The number of reversals of a joint."""

    topic = "reversals"
    count: int

    def __str__(self) -> str:
        often = {0: "never reverses", 1: "reverses only once"}.get(self.count, f"reverses only {self.count} times")
        return (
            f"the joint {often}: friction, offset and gravity are then strongly correlated. Record a motion that goes "
            "back and forth."
        )


@dataclass(frozen=True)
class HardlyMoves(Note):
    """The span of a joint in all of the training, and that of the joint that moves the most (rad or m).

    ``near`` is the middle of its positions.
    """

    topic = "still"
    span: float
    largest: float
    near: float
    unit: str

    def __str__(self) -> str:
        return (
            f"the joint hardly moves in training, by {short(self.span, 2)} {self.unit} where others move by up to "
            f"{short(self.largest, 2)}: nothing is seen of its friction and rotor, and where it does move its torque "
            "is not to be relied on. Record a motion of it, or hold it in the model: `lock` it at "
            f"{short(self.near, 4)}, and leave it out of `joints`, `position` and `torque`."
        )


@dataclass(frozen=True)
class LoopDiffers(Note):
    """The share of a joint's torque by which its controller, at the measured motion, commands another one."""

    topic = "loop"
    error: float

    def __str__(self) -> str:
        return (
            f"the controller asks for a torque that differs from the measured one by {percent(100 * self.error)}. "
            f"Check its gains and its reference; or something else drives this joint, too. {ASTRAY}"
        )


@dataclass(frozen=True)
class LoopGain(Note):
    """The measured torque is ``factor`` times what the controller commands.

    ``error`` and ``left`` are the differences between both without and with the factor, as shares of the torque.
    """

    topic = "loop"
    factor: float
    error: float
    left: float

    def __str__(self) -> str:
        return (
            f"the measured torque is {short(self.factor, 3)} times what the controller asks for (they differ by "
            f"{percent(100 * self.error)}, with this factor by {percent(100 * self.left)}). Check its gains and that "
            f"of the torque. {ASTRAY}"
        )


@dataclass(frozen=True)
class LoopUnused(Note):
    """Columns that are named as reference positions but used by no controller."""

    topic = "loop"
    columns: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"columns are named as reference positions ({join_names(map(repr, self.columns), 2)}). With the gains of "
            "the drives, in the section `simulation`, estimators that simulate the loop apply as well, and the model "
            "is judged in it."
        )


@dataclass(frozen=True)
class LoopVelocity(Note):
    """The number of steps over which drives difference positions: as ``given``, and as it fits the measured torque.

    ``error`` and ``left`` are the shares of the torque that do not fit with the given and with the fitted number;
    zero steps where the drives are faster than they are said to be.
    """

    topic = "loop"
    given: int
    steps: int
    error: float
    left: float

    def __str__(self) -> str:
        better = f"over {self.steps}" if self.steps else "with the velocity of the moment"
        setting = f"`velocity_steps: {self.steps}`, or the drive's `period`" if self.steps else "the drive's `period`"
        return (
            f"with its velocity over {count(self.given, 'step')}, the controller asks for a torque that differs from "
            f"the measured one by {percent(100 * self.error)}, {better} by {percent(100 * self.left)}. Give "
            f"{setting}. {ASTRAY}"
        )


@dataclass(frozen=True)
class PositionBeyondLimits(Note):
    """The range of a position, and the one that the robot file allows (rad or m).

    ``far`` beyond it the position is a motor's.
    """

    topic = "position limit"
    lower: float
    upper: float
    least: float
    most: float
    far: bool = False

    def __str__(self) -> str:
        return (
            f"the position runs from {short(self.lower, 4)} to {short(self.upper, 4)}, the file allows "
            f"{short(self.least, 4)} to {short(self.most, 4)}. "
            + (
                "Is it in another unit, or of a motor before its gear (see `transmission`)?"
                if self.far
                else "Check the unit, the sign and `zero`, or the file's limits."
            )
        )


@dataclass(frozen=True)
class VelocityAboveLimit(Note):
    """A peak velocity and its limit in the robot file (rad/s or m/s)."""

    topic = "velocity limit"
    peak: float
    limit: float

    def __str__(self) -> str:
        return (
            f"the velocity reaches {short(self.peak, 4)}, the robot file allows {short(self.limit, 4)} (rad/s or "
            "m/s). Check the units of position and time; or the positions are too noisy for this smoother."
        )


@dataclass(frozen=True)
class EffortAboveLimit(Note):
    """A peak torque and its limit in the robot file, in ``unit``.

    ``far`` above it the torque is another quantity or unit.
    """

    topic = "effort limit"
    peak: float
    limit: float
    unit: str
    far: bool

    def __str__(self) -> str:
        remedy = "Is it a motor current, or in another unit?" if self.far else "Check the unit and gain, or the file."
        return (
            f"the torque reaches {short(self.peak, 4)} {self.unit}, the robot file allows {short(self.limit, 4)}. "
            f"{remedy}"
        )


@dataclass(frozen=True)
class EffortFarBelowLimit(Note):
    """A peak torque below a thousandth of its limit in the robot file, in ``unit``."""

    topic = "effort limit"
    peak: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return (
            f"the torque stays below {short(self.peak)} {self.unit}, a thousandth of the robot file's limit "
            f"{short(self.limit, 4)}. Is it on the motor side of the gear, in another unit, or is the limit a "
            "placeholder?"
        )


@dataclass(frozen=True)
class CorrelatedParameters(Note):
    """The number of base parameters, and their condition number in these motions."""

    topic = "condition"
    rank: int
    condition: float

    def __str__(self) -> str:
        return (
            f"the {self.rank} base parameters are strongly correlated in these motions (condition number "
            f"{short(self.condition, 2)}): move more joints at the same time, faster, and over more of their range."
        )


class SearchKind(WordedEnum):
    """Kinds of searches that are skipped in a model of many joints."""

    FITS = (
        "fits",
        (
            "nothing was fitted: excitation, outliers of the torques, gravity, units and what explains the residual "
            "were not checked. Give joints that are not needed a position in `lock` of `model`."
        ),
    )
    CAUSES = (
        "causes",
        (
            "what explains the residual was not looked for: wrong gains, zeros, lengths and axes, missing terms, "
            "exchanged columns. Check a part of the joints, with the others in `lock` of `model`."
        ),
    )
    PAIRS = "pairs", "exchanged columns were looked for only among joints that follow each other."


@dataclass(frozen=True)
class SearchLeftOut(Note):
    """A search that was skipped because the model has so many joints and parameters."""

    topic = "left out"
    search: SearchKind
    joints: int
    parameters: int

    def __str__(self) -> str:
        size = f"{count(self.parameters, 'parameter')} of {count(self.joints, 'joint')}"
        return f"the model has {size}, so that {self.search.words}"


def _at(rows: Sequence[int], times: Sequence[float], total: int) -> str:
    """Return the indices of samples, from zero, and their times, as text."""
    ellipsis = ", ..." if total > len(rows) else ""
    indices, at = (", ".join(map(str, rows)), ", ".join(map(instant, times)))
    return f"sample{'s' if total > 1 else ''} {indices}{ellipsis} (t = {at}{ellipsis} s)"


def _fit_clause(masked: bool, held_out: bool, total: int = 2) -> str:
    subject, whom = ("It is", "it") if total == 1 else ("They are", "them")
    if held_out:
        return (
            f"The error on this log counts {whom} as measured; correct {whom} in the file, or leave {whom} out with a "
            "window."
        )
    return f"{subject} left out of the fit." if masked else f"{subject} in the fit: `outliers: mask` leaves {whom} out."


def _replacement_clause(replaced: bool, total: int = 2) -> str:
    subject, whom = ("It is", "it") if total == 1 else ("They are", "them")
    if replaced:
        return f"{subject} replaced by what is around {whom}, and left out of the fit."
    return f"{subject} used as measured: `outliers: mask` replaces {whom}."


def _lag_clause(lag: float, min_lag: float) -> str:
    """Return where in the other log a repeat begins, if it is more than ``min_lag`` (s) from its start."""
    if abs(lag) <= min_lag:
        return ""
    return f", {short(lag, 4)} s later in it" if lag > 0 else f", begun {short(-lag, 4)} s before it"
