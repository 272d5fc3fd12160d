"""Text for the findings on a log beyond its stamps; one small function per note of ``checks/log_notes.py``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch

from dynident.checks import log_notes
from dynident.identification.dataset import HeldOutOutliers
from dynident.report.note_words import words
from dynident.report.words import count, percent, short

CABLE = "Look for a loose cable, a lost message, or a full buffer where it was recorded."


def _at(rows: Sequence[int], times: Sequence[float], total: int) -> str:
    """Return the indices of samples, from zero, and their times, as text."""
    ellipsis = ", ..." if total > len(rows) else ""
    indices, at = (", ".join(map(str, rows)), ", ".join(map(_stamp, times)))
    return f"sample{'s' if total > 1 else ''} {indices}{ellipsis} (t = {at}{ellipsis} s)"


def _stamp(t: float) -> str:
    """Format a time to 0.1 ms, also of a clock that began long ago."""
    return f"{round(t, 4):.15g}"


def _fit_words(masked: bool, held_out: bool, total: int = 2) -> str:
    subject, whom = ("It is", "it") if total == 1 else ("They are", "them")
    if held_out:
        return (
            f"The error on this log counts {whom} as measured; correct {whom} in the file, or leave {whom} out with a "
            "window."
        )
    return f"{subject} left out of the fit." if masked else f"{subject} in the fit: `outliers: mask` leaves {whom} out."


def _replacement_words(replaced: bool, total: int = 2) -> str:
    subject, whom = ("It is", "it") if total == 1 else ("They are", "them")
    if replaced:
        return f"{subject} replaced by what is around {whom}, and left out of the fit."
    return f"{subject} used as measured: `outliers: mask` replaces {whom}."


@singledispatch
def figures_words(message: object) -> str:  # noqa: ARG001
    """Return size and rows where each of several similar findings has its own, else an empty text."""
    return ""


@figures_words.register(log_notes.PositionSpikes)
@figures_words.register(log_notes.TorqueSpikes)
def _(note: log_notes.PositionSpikes | log_notes.TorqueSpikes) -> str:
    return f"{note.count} by up to {short(note.largest, 4)}, {_at(note.rows, note.times, note.count)}"


@figures_words.register(log_notes.FrozenPosition)
@figures_words.register(log_notes.FrozenTorque)
def _(note: log_notes.FrozenPosition | log_notes.FrozenTorque) -> str:
    return f"{note.count} samples at {note.value:.6g} from sample {note.row}"


@figures_words.register
def _(note: log_notes.ClippedTorque) -> str:
    return f"{note.count} at {note.value:.6g}, first sample {note.row}"


@figures_words.register
def _(note: log_notes.PositionJump) -> str:
    return f"by {short(note.size, 4)} after sample {note.row}"


@words.register
def _(note: log_notes.PositionSpikes) -> str:
    return (
        f"{count(note.count, 'position')} {'stands' if note.count == 1 else 'stand'} out by up to "
        f"{short(note.largest)}: {_at(note.rows, note.times, note.count)}. "
        f"{_replacement_words(note.replaced, note.count)} {CABLE}"
    )


@words.register
def _(note: log_notes.ManyPositionSpikes) -> str:
    return (
        f"{note.count} positions stand out by up to {short(note.largest)}, too many to be replaced: "
        f"{_at(note.rows, note.times, note.count)}. Correct them in the file. {CABLE}"
    )


@words.register
def _(note: log_notes.FrozenPosition) -> str:
    return (
        f"the position is {note.value:.6g} for {note.count} samples, from sample {note.row} "
        f"(t = {_stamp(note.start)} s) to t = {_stamp(note.stop)} s, and jumps: it was not read there. "
        f"{_replacement_words(note.replaced)} {CABLE}"
    )


@words.register
def _(note: log_notes.PositionJump) -> str:
    repeats = "once more" if note.count == 2 else f"{note.count - 1} more times"
    suffix = f", and {repeats}" if note.count > 1 else ""
    return (
        f"the position jumps by {short(note.size, 4)} after sample {note.row} (t = {_stamp(note.time)} s){suffix}: "
        "are two "
        "recordings joined, or did the encoder lose counts? Give the pieces as separate logs, by windows."
    )


@words.register
def _(note: log_notes.InterpolatedPositions) -> str:
    return (
        f"{percent(100 * note.share, 2)} of the positions lie exactly on the line between their neighbours: they were "
        "interpolated from fewer samples, which adds no knowledge and spoils accelerations. Log at the rate of the "
        "encoder, or keep only its own samples."
    )


@words.register
def _(note: log_notes.TorqueSpikes) -> str:
    return (
        f"{count(note.count, 'torque')} {'stands' if note.count == 1 else 'stand'} out by up to "
        f"{short(note.largest, 4)}, "
        f"unlike the motion: {_at(note.rows, note.times, note.count)}. "
        f"{_fit_words(note.masked, note.held_out, note.count)} {CABLE}"
    )


@words.register
def _(note: log_notes.ManyTorqueOutliers) -> str:
    return (
        f"{percent(100 * note.share, 2)} of the torques look like outliers, first sample {note.row} "
        f"(t = {_stamp(note.time)} s): too many to be left out, so that none is. Is it the right column, or was it "
        "recorded badly?"
    )


@words.register
def _(note: log_notes.FrozenTorque) -> str:
    level = "zero" if note.value == 0 else f"{note.value:.6g}"
    return (
        f"the torque is {level} for {note.count} samples, from sample {note.row} "
        f"(t = {_stamp(note.start)} s) to t = {_stamp(note.stop)} s, though the motion needs another: it was not "
        f"read there, or the drive was off. {_fit_words(note.masked, note.held_out)} {CABLE}"
    )


@words.register
def _(note: log_notes.ClippedTorque) -> str:
    return (
        f"{note.count} torques are exactly {note.value:.6g}, first sample {note.row} (t = {_stamp(note.time)} s), "
        "where the motion needs more: the sensor or the signal is at its limit. "
        f"{_fit_words(note.masked, note.held_out)} Record with a larger range, or a gentler motion."
    )


@words.register
def _(note: HeldOutOutliers) -> str:
    outliers = "is an outlier" if note.count == 1 else "are outliers"
    return (
        f"{note.log}: {count(note.count, 'torque')} of {', '.join(note.joints)} {outliers}, with which the error on "
        f"this held-out log is {percent(note.error)}, and {percent(note.without)} without"
    )


def _lag(lag: float, min_lag: float) -> str:
    """Return where in the other log a repeat begins, if it is more than ``min_lag`` (s) from its start."""
    if abs(lag) <= min_lag:
        return ""
    return f", {short(lag, 4)} s later in it" if lag > 0 else f", begun {short(-lag, 4)} s before it"


@words.register
def _(note: log_notes.SameData) -> str:
    return (
        f"holds the same samples as {note.other!r} of the training{_lag(note.lag, 1e-6)}: nothing is held out, and "
        "its error says nothing. Give another recording for validation."
    )


@words.register
def _(note: log_notes.RepeatedMotion) -> str:
    return (
        f"repeats the motion of {note.other!r}{_lag(note.lag, 1e-3)}, to {percent(note.error, 2)}: its error shows "
        "repeatability, not how the model does on another motion. Hold out a different motion. (Repeats at another "
        "speed are not looked for.)"
    )


@words.register
def _(note: log_notes.PerhapsRadians) -> str:
    return (
        f"no joint moves more than {short(note.span, 2)} rad; as degrees that should have been radians, the "
        "positions leave "
        f"{percent(note.after)} of the torque unexplained instead of {percent(note.before)}. Are they in rad? Set "
        "`unit: rad`."
    )


@words.register
def _(note: log_notes.GravityCompensated) -> str:
    return (
        f"the torque shows {note.factor:z.2f} +- {short(note.std, 2)} times the gravity of the arm: without it "
        "the plain "
        f"fit leaves {percent(note.after)} instead of {percent(note.before)}. Was it logged after gravity "
        "compensation, or is the arm mounted so that gravity does not act? Log the whole torque, add the compensation "
        "to it by `sum`, or set `gravity: [0, 0, 0]` for a model without gravity."
    )


@words.register
def _(note: log_notes.NoFriction) -> str:
    return (
        f"the torque shows almost no friction: at most {percent(note.share, 2)} of any joint's. Was it logged after "
        "friction compensation, measured behind the gears, or simulated without friction? The model then gives the "
        "torque of the links: for feedforward, add the friction of the drives."
    )


@words.register
def _(note: log_notes.SlowMotion) -> str:
    return (
        f"accelerations explain only {percent(note.share, 2)} of the torque, less than the {percent(note.residual, 2)} "
        "that the fit leaves: the motion is too slow to show inertias, and faster motion would not be predicted. "
        f"Record one at least {short(note.faster, 2)} times as fast."
    )
