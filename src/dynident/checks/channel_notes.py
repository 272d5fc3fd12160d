"""Notes on the stamps and channels of a log; each is the message of a ``Finding``."""

from __future__ import annotations

from math import floor, log10

from dynident.runtime import Note, Severity, count, instant, percent, short

MAX_SAMPLE_INTERVAL = 0.15  # s: samples further apart may be stamped in another unit


class TooFewSamples(Note):
    """A log has fewer samples than the ``least`` number that can be smoothed; ``step`` (s) is their spacing."""

    severity = Severity.ERROR
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


class LongGap(Note):
    """The first of ``count`` gaps: its length (s), the time (s) before it, and its length over the median step."""

    severity = Severity.ERROR
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


class PerhapsDegrees(Note):
    """A position spans more rad, or reaches more rad/s, than a robot arm does."""

    severity = Severity.ERROR
    topic = "degrees"
    span: float
    speed: float

    def __str__(self) -> str:
        return (
            f"the position spans {self.span:.4g} rad at up to {self.speed:.4g} rad/s, more than a robot arm does; is "
            "it in degrees, in counts, or that of the motor before the gear? Set `unit: deg` or `gain` in the joint's "
            "position channel, or `multi_turn: true` if it does turn that far."
        )


class UnorderedRows(Note):
    """Successive positions of every joint differ as much as any two."""

    severity = Severity.ERROR
    topic = "order"

    def __str__(self) -> str:
        return (
            "successive positions differ as much as any two, so that they show no motion: the rows are not in order of "
            "time, or too far apart. Sort them by time; if they were drawn at random, take the whole recording."
        )


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


class ConstantTorque(Note):
    """A torque (N m or N) is the same throughout."""

    topic = "dead"
    value: float

    def __str__(self) -> str:
        return (
            f"the torque is {self.value:.6g} throughout; check that the right column is named and was recorded. The "
            "fit leaves its equation out, unless the other joints show that the joint turns freely."
        )


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


class SamplingJitter(Note):
    """The time steps have an rms ``jitter``.

    Equal spacing makes positions ``factor`` times noisier, None where unclear.
    """

    severity = Severity.INFO
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


class WrappedPosition(Note):
    """A position jumps ``count`` times by its whole range ``period`` (rad, m), first after sample ``row`` at ``time``
    (s)."""

    severity = Severity.ERROR
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


class WrongTimeUnit(Note):
    """A rate (Hz) and speed (rad/s, m/s) that no recording has.

    With the stamps multiplied by ``factor`` both would be plausible.
    """

    severity = Severity.ERROR
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


def _vary(jitter: float) -> str:
    return f"the time steps vary by {percent(100 * jitter, 2)} rms, and the positions"


def _times(factor: float) -> str:
    if factor > 1000:
        return "over 1000 times"
    return f"{short(factor)} times" if factor >= 2 else f"{100 * (factor - 1):.0f} %"
