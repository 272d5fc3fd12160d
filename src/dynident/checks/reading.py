"""The text of what reading a log raises or warns of; other findings are worded in ``report``, which ``io`` is below."""

from __future__ import annotations

from functools import singledispatch
from math import floor, log10

from dynident.checks import log_notes, notes
from dynident.errors import Note

__all__ = ["reading_words"]

SLOW = 0.15  # s: samples further apart may be stamped in another unit


@singledispatch
def reading_words(note: Note) -> str:
    """Return the text of what is wrong with a log that is read, with the remedy."""
    raise TypeError(f"there is no text for {type(note).__name__}")


def _instant(t: float) -> str:
    """Return a time to 0.1 ms, also of a clock that began long ago."""
    return f"{round(t, 4):.15g}"


@reading_words.register
def _(note: notes.TooFewSamples) -> str:
    held = "one sample" if note.samples == 1 else f"{note.samples} samples"
    apart, remedy = "", "widen the window or record longer."
    if note.step > SLOW:
        apart, remedy = f", {note.step:.3g} s apart", f"is the `unit` of `time` right? Else {remedy}"
    return f"only {held}{apart}; at least {note.least} are needed: {remedy}"


@reading_words.register
def _(note: notes.LongGap) -> str:
    every = "the only one" if note.count == 1 else f"{note.count} such gaps in all"
    return (
        f"a gap of {note.length:.4g} s after t = {_instant(note.after)} s "
        f"({note.ratio:.0f} times the median step; {every}). "
        "Leave it out with a window, or set `gaps: split` to smooth each piece separately."
    )


@reading_words.register
def _(note: notes.UnevenSteps) -> str:
    return (
        f"the time steps vary by {100 * note.jitter:.0f} % about {note.step:.4g} s (from {note.shortest:.3g} to "
        f"{note.longest:.3g} s). Where the clock of the stamps is not that of the sampling, this acts as position "
        "noise."
    )


@reading_words.register
def _(note: notes.NeverMoves) -> str:
    values = "one value" if note.levels == 1 else f"{note.levels} distinct values"
    return (
        f"the position never moves ({values} near {note.near:.6g}): nothing about this joint's "
        "own motion can be identified. Check that the right column is named, or use another window; a joint of a robot "
        "file that is to stand still goes under `model.lock`."
    )


@reading_words.register
def _(note: notes.PerhapsDegrees) -> str:
    return (
        f"the position spans {note.span:.4g} rad at up to {note.speed:.4g} rad/s, more than a robot arm does; is it in "
        "degrees? "
        "Set `unit: deg`, or `multi_turn: true` in the joint's position channel if it does turn that far."
    )


@reading_words.register
def _(note: notes.QuantisedPosition) -> str:
    return (
        f"the position is quantised in steps of {note.resolution:.4g}, and most samples differ by fewer than "
        f"{note.counts:.0f} of them: the error is not white noise, so do not rely on a noise level estimated from it."
    )


@reading_words.register
def _(note: notes.ConstantTorque) -> str:
    return (
        f"the torque is {note.value:.6g} throughout; check that the right column is named and was recorded. The fit "
        "leaves its equation out, unless the other joints show that the joint turns freely."
    )


@reading_words.register
def _(note: notes.ArmAtRest) -> str:
    digits = max(0, 1 - floor(log10(max(note.stop - note.start, 1e-9))))
    return (
        f"the arm is at rest from {note.start:.{digits}f} to {note.stop:.{digits}f} s: static friction there can take "
        "any value up to its limit. "
        + (
            "Set `rests: trim`, `min_speed`, or a window without this part."
            if note.kept
            else "At the ends of a log this is left out, and within it where that predicts the torque in motion better."
        )
    )


@reading_words.register
def _(note: notes.EquallySpaced) -> str:
    lost = f", {note.lost} lost samples left open" if note.lost else ""
    noise = f"{note.factor:.3g} times less" if note.factor >= 1 else f"{1 / note.factor:.3g} times more"
    return (
        f"samples are taken as equally spaced, at {note.rate:.6g} Hz{lost}: the steps of the stamps vary by "
        f"{100 * note.jitter:.2g} %, and the positions are {noise} noisy. `time: {{ spacing: stamps }}` undoes it."
    )


@reading_words.register
def _(note: log_notes.WrappedPosition) -> str:
    times = "once" if note.count == 1 else f"{note.count} times"
    return (
        f"the position wraps: it jumps {times} by {note.period:.5g} rad, its whole range, first after sample "
        f"{note.row} (t = {_instant(note.time)} s). Set `wraps` in its position channel: the value at which the column "
        "starts anew, such as 360 for degrees or 6.283185307179586 for rad."
    )


@reading_words.register
def _(note: log_notes.WrongTimeUnit) -> str:
    units = {1e-3: "ms", 1e-6: "us", 1e-9: "ns"}
    if note.factor < 1:
        remedy = f"are the stamps in {units[note.factor]} and declared as s? Set `unit: {units[note.factor]}`"
    else:
        unit = units[1 / note.factor]
        remedy = f"are the stamps in s and declared as {unit}? Set `unit: s`"
    return (
        f"a rate of {note.rate:.3g} Hz with speeds up to {note.speed:.3g} rad/s or m/s is not that of a robot; with "
        f"stamps multiplied by {note.factor:g} both would be usual: {remedy}."
    )


@reading_words.register
def _(note: log_notes.PerhapsMillimetres) -> str:
    return (
        f"the position spans {note.span:.4g} m at up to {note.speed:.4g} m/s, more than a sliding joint does; is it in "
        "millimetres? Set `unit: mm`."
    )
