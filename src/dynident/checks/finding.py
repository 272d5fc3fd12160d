"""The topics of findings, and findings on reading a log as text."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from functools import singledispatch
from math import floor, log10

from dynident.checks import log_notes, notes
from dynident.runtime import Finding, InputError, Note, Severity

MAX_SAMPLE_INTERVAL = 0.15  # s: samples further apart may be stamped in another unit


@singledispatch
def reading_words(note: Note) -> str:
    """Return the text of what is wrong with a log, with the remedy."""
    raise TypeError(f"there is no text for {type(note).__name__}")


def _instant(t: float) -> str:
    """Return a time rounded to 0.1 ms, in full also for clocks that began long ago."""
    return f"{round(t, 4):.15g}"


@reading_words.register
def _too_few_samples(note: notes.TooFewSamples) -> str:
    count = "one sample" if note.samples == 1 else f"{note.samples} samples"
    spacing, remedy = "", "widen the window or record longer."
    if note.step > MAX_SAMPLE_INTERVAL:
        spacing, remedy = f", {note.step:.3g} s apart", f"is the `unit` of `time` right? Else {remedy}"
    return f"only {count}{spacing}; at least {note.least} are needed: {remedy}"


@reading_words.register
def _long_gap(note: notes.LongGap) -> str:
    number_of_gaps = "the only one" if note.count == 1 else f"{note.count} such gaps in all"
    return (
        f"a gap of {note.length:.4g} s after t = {_instant(note.after)} s "
        f"({note.ratio:.0f} times the median step; {number_of_gaps}). "
        "Leave it out with a window, or set `gaps: split` to smooth each piece separately."
    )


@reading_words.register
def _uneven_steps(note: notes.UnevenSteps) -> str:
    return (
        f"the time steps vary by {100 * note.jitter:.0f} % about {note.step:.4g} s (from {note.shortest:.3g} to "
        f"{note.longest:.3g} s). Where the clock of the stamps is not that of the sampling, this acts as position "
        "noise."
    )


@reading_words.register
def _never_moves(note: notes.NeverMoves) -> str:
    values = "one value" if note.levels == 1 else f"{note.levels} distinct values"
    return (
        f"the position never moves ({values} near {note.near:.6g}): nothing about this joint's "
        "own motion can be identified. Check that the right column is named, or use another window; a joint of a robot "
        "file that is to stand still goes under `model.lock`."
    )


@reading_words.register
def _perhaps_degrees(note: notes.PerhapsDegrees) -> str:
    return (
        f"the position spans {note.span:.4g} rad at up to {note.speed:.4g} rad/s, more than a robot arm does; is it in "
        "degrees? "
        "Set `unit: deg`, or `multi_turn: true` in the joint's position channel if it does turn that far."
    )


@reading_words.register
def _quantised_position(note: notes.QuantisedPosition) -> str:
    return (
        f"the position is quantised in steps of {note.resolution:.4g}, and most samples differ by fewer than "
        f"{note.counts:.0f} of them: the error is not white noise, so do not rely on a noise level estimated from it."
    )


@reading_words.register
def _constant_torque(note: notes.ConstantTorque) -> str:
    return (
        f"the torque is {note.value:.6g} throughout; check that the right column is named and was recorded. The fit "
        "leaves its equation out, unless the other joints show that the joint turns freely."
    )


@reading_words.register
def _arm_at_rest(note: notes.ArmAtRest) -> str:
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
def _equally_spaced(note: notes.EquallySpaced) -> str:
    lost = f", {note.lost} lost samples left open" if note.lost else ""
    noise = f"{note.factor:.3g} times less" if note.factor >= 1 else f"{1 / note.factor:.3g} times more"
    return (
        f"samples are taken as equally spaced, at {note.rate:.6g} Hz{lost}: the steps of the stamps vary by "
        f"{100 * note.jitter:.2g} %, and the positions are {noise} noisy. `time: {{ spacing: stamps }}` undoes it."
    )


@reading_words.register
def _wrapped_position(note: log_notes.WrappedPosition) -> str:
    times = "once" if note.count == 1 else f"{note.count} times"
    return (
        f"the position wraps: it jumps {times} by {note.period:.5g} rad, its whole range, first after sample "
        f"{note.row} (t = {_instant(note.time)} s). Set `wraps` in its position channel: the value at which the column "
        "starts anew, such as 360 for degrees or 6.283185307179586 for rad."
    )


@reading_words.register
def _wrong_time_unit(note: log_notes.WrongTimeUnit) -> str:
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
def _perhaps_millimetres(note: log_notes.PerhapsMillimetres) -> str:
    return (
        f"the position spans {note.span:.4g} m at up to {note.speed:.4g} m/s, more than a sliding joint does; is it in "
        "millimetres? Set `unit: mm`."
    )


class Topic(StrEnum):
    """What a finding is about: a stable name for programs."""

    ABOUT_ORIGIN = "about origin"
    AXIS = "axis"
    BASE_TILT = "base tilt"
    CLIPPED = "clipped"
    CLOCK = "clock"
    COMPENSATED = "gravity compensated"
    CONDITION = "condition"
    COPIED = "copied"
    DEAD = "dead"
    DEGREES = "degrees"
    EFFORT_LIMIT = "effort limit"
    FAR = "far"
    FLOATING = "floating"
    FOREIGN = "foreign"
    FROZEN = "frozen position"
    FROZEN_TORQUE = "frozen torque"
    FRICTION = "friction"
    GAIN = "gain"
    GAP = "gap"
    GRAVITY = "gravity"
    IMPOSSIBLE = "impossible"
    INTERPOLATED = "interpolated"
    JITTER = "jitter"
    JUMP = "jump"
    LEFT_OUT = "left out"
    LENGTH = "length"
    LIMBS = "limbs"
    LIMITS = "limits"
    LOOP = "loop"
    LOST = "lost"
    MANY_OUTLIERS = "many outliers"
    MASSLESS = "massless"
    MILLIMETRES = "millimetres"
    MISSING_TERM = "missing term"
    MOTION = "motion"
    NOT_EXCITED = "not excited"
    ODD_LOG = "odd log"
    PAYLOAD = "payload"
    POINT = "point"
    POSITION_LIMIT = "position limit"
    POSITION_SPIKES = "position spikes"
    QUANTISED = "quantised"
    RADIANS = "radians"
    REPEAT = "repeat"
    REST = "rest"
    REVERSALS = "reversals"
    SAMPLES = "samples"
    SCALE = "scale"
    SHAPES = "shapes"
    SIGN = "sign"
    SLOW = "slow"
    SPREAD = "spread"
    STALE = "stale"
    STAMPS = "stamps"
    STILL = "still"
    SWAPPED = "swapped"
    TIME_OFFSET = "time offset"
    TIME_UNIT = "time unit"
    TORQUE_SPIKES = "torque spikes"
    TOTAL_MASS = "total mass"
    UNEXPLAINED = "unexplained"
    UNREAD = "unread"
    UNUSABLE = "unusable"
    VELOCITY_LIMIT = "velocity limit"
    WRAPPED = "wrapped"
    ZERO = "zero"


def reading_line(finding: Finding) -> str:
    """Return the text of a finding on reading a log, with the joint.

    Raises TypeError for notes that only ``report`` puts into words.
    """
    text = reading_words(finding.message) if isinstance(finding.message, Note) else finding.message
    return text if finding.joint is None else f"joint {finding.joint!r}: {text}"


def require(findings: Iterable[Finding], source: str) -> None:
    """Raise InputError that lists every finding that is an error, one per line; do nothing where there is none."""
    errors = [reading_line(finding) for finding in findings if finding.severity is Severity.ERROR]
    if errors:
        raise InputError(f"{source}: " + "\n  ".join(errors))
