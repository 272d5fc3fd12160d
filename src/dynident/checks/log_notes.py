"""Notes on outliers, units and repeats of a log; each is the message of a ``Finding``."""

from __future__ import annotations

from dynident.runtime import Note, Use, count, instant, percent, short

CABLE = "Look for a loose cable, a lost message, or a full buffer where it was recorded."


class Spikes(Note):
    """``count`` values are spikes, the first at these ``rows`` and ``times`` (s), the ``largest`` in SI units."""

    count: int
    rows: tuple[int, ...]
    times: tuple[float, ...]
    largest: float

    @property
    def place(self) -> str:
        """Indices of the samples, from zero, and their times."""
        ellipsis = ", ..." if self.count > len(self.rows) else ""
        rows, times = ", ".join(map(str, self.rows)), ", ".join(map(instant, self.times))
        return f"sample{'s' if self.count > 1 else ''} {rows}{ellipsis} (t = {times}{ellipsis} s)"

    @property
    def figures(self) -> str:
        """Its size and rows."""
        return f"{self.count} by up to {short(self.largest, 4)}, {self.place}"


class FrozenValue(Note):
    """A ``value`` (SI) is the same from sample ``row`` for ``count`` samples, from ``start`` to ``stop`` (s)."""

    row: int
    count: int
    start: float
    stop: float
    value: float

    @property
    def place(self) -> str:
        """The samples and their times."""
        first = f"from sample {self.row} (t = {instant(self.start)} s)"
        return f"for {self.count} samples, {first} to t = {instant(self.stop)} s"

    @property
    def figures(self) -> str:
        """Its size and rows."""
        return f"{self.count} samples at {self.value:.6g} from sample {self.row}"


class PositionSpikes(Spikes):
    """``count`` positions are spikes, the first at these ``rows`` and ``times`` (s), the ``largest`` in rad or m.

    They are ``replaced`` by what is around them, or kept.
    """

    topic = "position spikes"
    replaced: bool

    def __str__(self) -> str:
        return (
            f"{count(self.count, 'position')} {'stands' if self.count == 1 else 'stand'} out by up to "
            f"{short(self.largest)}: {self.place}. {_replacement_clause(self.replaced, self.count)} {CABLE}"
        )


class ManyPositionSpikes(PositionSpikes):
    """As ``PositionSpikes``, where they are too many to be replaced."""

    forbids = Use.CONTROL

    def __str__(self) -> str:
        return (
            f"{self.count} positions stand out by up to {short(self.largest)}, too many to be replaced: "
            f"{self.place}. Correct them in the file. {CABLE}"
        )


class FrozenPosition(FrozenValue):
    """A position is the same from sample ``row`` for ``count`` samples, from ``start`` to ``stop`` (s), and jumps."""

    topic = "frozen position"
    replaced: bool

    def __str__(self) -> str:
        return (
            f"the position is {self.value:.6g} {self.place}, and jumps: it was not read there. "
            f"{_replacement_clause(self.replaced)} {CABLE}"
        )


class PositionJump(Note):
    """A position jumps by ``size`` (rad, m) after sample ``row`` at ``time`` (s), and stays; ``count`` times in all."""

    topic = "jump"
    forbids = Use.CONTROL
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


class TorqueSpikes(Spikes):
    """``count`` torques are spikes, the first at these ``rows`` and ``times`` (s), the ``largest`` in N m or N.

    They are ``masked`` in the fit, or kept; those of a ``held_out`` log are judged as measured.
    """

    topic = "torque spikes"
    masked: bool
    held_out: bool

    def __str__(self) -> str:
        return (
            f"{count(self.count, 'torque')} {'stands' if self.count == 1 else 'stand'} out by up to "
            f"{short(self.largest, 4)}, unlike the motion: {self.place}. "
            f"{_fit_clause(self.masked, self.held_out, self.count)} {CABLE}"
        )


class ManyTorqueOutliers(Note):
    """The ``share`` of torques that look wrong is too large for outliers.

    The first is sample ``row`` at ``time`` (s).
    """

    topic = "many outliers"
    forbids = Use.CONTROL
    share: float
    row: int
    time: float

    def __str__(self) -> str:
        return (
            f"{percent(100 * self.share, 2)} of the torques look like outliers, first sample {self.row} (t = "
            f"{instant(self.time)} s): too many to leave out, so all are kept. Is it the right column, or was it "
            "recorded badly?"
        )


class FrozenTorque(FrozenValue):
    """A torque is the same from sample ``row`` for ``count`` samples, from ``start`` to ``stop`` (s), unlike the
    model's; ``masked`` and ``held_out`` as in ``TorqueSpikes``."""

    topic = "frozen torque"
    masked: bool
    held_out: bool

    def __str__(self) -> str:
        level = "zero" if self.value == 0 else f"{self.value:.6g}"
        return (
            f"the torque is {level} {self.place}, although the motion needs another: it was not read, or the drive "
            f"was off. {_fit_clause(self.masked, self.held_out)} {CABLE}"
        )


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


class SameData(Note):
    """Two logs hold the same samples, in the ``other`` one ``lag`` (s) later, so that nothing is held out."""

    topic = "repeat"
    forbids = Use.CONTROL
    other: str
    lag: float

    def __str__(self) -> str:
        return (
            f"holds the same samples as {self.other!r} of the training{_lag_clause(self.lag, 1e-6)}: nothing is held "
            "out, and its error says nothing. Give another recording for validation."
        )


class SharedSamples(Note):
    """This ``share`` of the samples of a held-out log is in the ``other`` one of the training, too."""

    topic = "repeat"
    forbids = Use.CONTROL
    other: str
    share: float

    def __str__(self) -> str:
        return (
            f"{percent(100 * self.share)} of its samples are those of {self.other!r} of the training, so that its "
            "error says little of what the fit has not seen. Choose windows that do not overlap, or another recording."
        )


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
            "Repeats at another speed are not looked for."
        )


class PerhapsRadians(Note):
    """All positions multiplied by 180/pi explain the torque with an error of ``after`` % instead of ``before`` %.

    Where ``others_move`` more than ``span`` (rad), they are those of one joint.
    """

    topic = "radians"
    forbids = Use.CONTROL
    span: float
    before: float
    after: float
    others_move: bool = False

    def __str__(self) -> str:
        subject = "this joint moves no" if self.others_move else "no joint moves"
        return (
            f"{subject} more than {short(self.span, 2)} rad; as degrees that should have been radians, the "
            f"positions leave {percent(self.after)} of the torque unexplained instead of {percent(self.before)}. Are "
            "they in rad? Set `unit: rad`."
        )


class GravityCompensated(Note):
    """The torque contains the share ``factor`` +- ``std`` of the gravity of the inertias.

    ``before`` and ``after`` are the errors (%) of the fit with gravity and with that share.
    """

    topic = "gravity compensated"
    forbids = Use.CONTROL
    factor: float
    std: float
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"the torque shows {self.factor:z.2f} +- {short(self.std, 2)} times the gravity of the arm: with this "
            f"the plain fit leaves {percent(self.after)} instead of {percent(self.before)}. Was it logged after "
            "gravity compensation, or is the arm mounted so that gravity does not act? Log the whole torque, add the "
            "compensation to it by `sum`, or set `gravity: [0, 0, 0]` for a model without gravity."
        )


class NoFriction(Note):
    """Friction is at most ``share`` (%) of the torque of any joint."""

    topic = "friction"
    advises = True
    share: float

    def __str__(self) -> str:
        return (
            f"the torque shows almost no friction: at most {percent(self.share, 2)} of any joint's. Was it computed "
            "by the controller instead of measured, logged after friction compensation, measured behind the gears, or "
            "simulated without friction? The model then gives the torque of the links, at best: for feedforward, add "
            "the friction of the drives."
        )


class SlowMotion(Note):
    """Accelerations explain only this ``share`` of the torque (%, of its rms), less than the ``residual`` of the fit
    (%); a motion ``faster`` by this factor would show inertias."""

    topic = "slow"
    advises = True
    forbids = Use.SIMULATION
    share: float
    residual: float
    faster: float

    def __str__(self) -> str:
        return (
            f"accelerations explain only {percent(self.share, 2)} of the torque, less than the "
            f"{percent(self.residual, 2)} that the fit leaves: the motion is too slow to show inertias, and faster "
            f"motion would not be predicted. Record one at least {short(self.faster, 2)} times as fast."
        )


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
