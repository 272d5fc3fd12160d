"""Implausible units: of the time stamps, of sliding joints and of angles, by a log's rate, speeds and ranges."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.checks import channel_notes, log_notes
from dynident.estimators.least_squares import solve_least_squares
from dynident.models import Model
from dynident.motion.log import Log, Motion, thin_motions
from dynident.motion.splines import noise_sigma
from dynident.regression import Regression, Selection
from dynident.runtime import Finding, Severity
from dynident.runtime.arrays import Array

MINIMUM_SAMPLES = 30
"""Least number of samples of a log that can be smoothed."""

MAX_GAP_STEPS = 12.0  # x the median step: a smoother bridges the few samples that a robot's scheduler may lose
_MAX_JITTER = 0.1  # rms of the steps about their median, as a fraction of it
# share of steps within 10 % of the median from which on a step of 1.5 medians is a lost sample
_MIN_REGULAR_SHARE = 0.9
_MAX_LOST_SHARE = 0.01  # share of lost samples to warn of
_MAX_NOISE_RATIO = 0.8  # ratio of noises below which one time axis is clearly better
_MIN_JITTER = 1e-6  # jitter below which stamps and equal spacing are the same
_MAX_ROUNDING_JITTER = 1e-4  # jitter that stamps of few digits have
# steps that the stamps may be from equal spacing, in the median of parts of the log
_MAX_DRIFT_STEPS, _DRIFT_PARTS = 0.5, 20


@dataclass(frozen=True)
class Timing:
    """The time axis of a log: number of ``samples``, ``length`` (s), median ``step`` (s), rms ``jitter`` over the step.

    ``rate`` (Hz) is the slope of the straight line through the stamps, with missing samples counted. ``shortest`` and
    ``longest`` are steps in s; ``missing`` is the number of samples lost in longer steps. ``even`` is the noise of the
    positions if they were equally spaced, relative to that at the stamps, for the joint in which the two differ most;
    ``slots`` is the same for stamps rounded to whole steps. Both are 1 where there is no difference.
    """

    samples: int
    length: float
    step: float
    rate: float
    jitter: float
    shortest: float
    longest: float
    missing: int
    even: float = 1.0
    slots: float = 1.0


def timing(log: Log) -> Timing:
    """Return the statistics of a log's time axis.

    The noise is that of ``noise_sigma``: divided differences cancel the motion only on the true time axis, so the axis
    with the lower noise is closer to the instants at which the positions were sampled.
    """
    steps = np.diff(log.t)
    median = float(np.median(steps))
    jitter, unbroken = _relative_jitter(steps), bool((steps <= MAX_GAP_STEPS * median).all())
    # number the samples by whole sampling periods, so that lost ones keep their place
    step_counts = _whole_steps(steps / median)
    places = np.append(0.0, np.cumsum(step_counts))
    slope = float(np.polyfit(places, log.t - log.t[0], 1)[0]) if unbroken and len(log) > 2 else median
    even = slots = 1.0
    if jitter > _MIN_JITTER and len(log) >= MINIMUM_SAMPLES and unbroken:
        even = _noise_ratio(log, np.linspace(log.t[0], log.t[-1], len(log)))
        slots = _noise_ratio(log, places * median)
    return Timing(
        samples=len(log),
        length=float(log.t[-1] - log.t[0]),
        step=median,
        rate=1 / slope,
        jitter=jitter,
        shortest=float(steps.min()),
        longest=float(steps.max()),
        missing=int((step_counts - 1).sum()) if unbroken else 0,
        even=even,
        slots=slots,
    )


def respace(log: Log, *, always: bool = False) -> tuple[Log, channel_notes.EquallySpaced | None]:
    """Return the log with equal spacing where its positions are less noisy on it, and a note of that.

    The straight line through the stamps gives the times; lost samples keep their place. Where the stamps leave
    the line for long, which a late stamp does not, they have true gaps and are kept. With ``always`` the noise
    does not matter.
    """
    t, steps = log.t, np.diff(log.t)
    jitter = _relative_jitter(steps)
    if (
        jitter <= (_MIN_JITTER if always else _MAX_ROUNDING_JITTER)
        or len(log) < MINIMUM_SAMPLES
        or len(_long_steps(log))
    ):
        return log, None
    places = np.append(0.0, np.cumsum(_whole_steps(steps / float(np.median(steps)))))
    lost = int(places[-1]) + 1 - len(log)
    # the loss of samples may itself be an artefact of the stamps: also try the line that counts none as lost
    axes = [_fit_line(t, places), *([_fit_line(t, np.arange(len(log)))] if lost and not always else ())]
    ratios = [_noise_ratio(log, axis) if always or _follows_line(t, axis) else 1.0 for axis in axes]
    best = int(np.argmin(ratios))
    if not always and ratios[best] >= _MAX_NOISE_RATIO:
        return log, None
    lost *= best == 0
    note = channel_notes.EquallySpaced(jitter, 1 / ratios[best], (len(t) - 1 + lost) / float(np.ptp(axes[best])), lost)
    return replace(log, t=axes[best]), note


def _fit_line(t: Array, places: NDArray[Any]) -> Array:
    """Return the straight line (N) through the stamps, as a function of their numbers ``places``."""
    middle, centred = places.mean(), t - t.mean()
    slope = float((places - middle) @ centred / np.square(places - middle).sum())
    return np.asarray(t.mean() + slope * (places - middle))


def _follows_line(t: Array, line: Array) -> bool:
    """Return whether the stamps stay near the line, except for single ones."""
    # medians of parts ignore single late stamps, but not a shift that lasts
    drift = [float(np.median(part)) for part in np.array_split(t - line, _DRIFT_PARTS)]
    return float(np.ptp(drift)) < _MAX_DRIFT_STEPS * float(np.median(np.diff(t)))


def _relative_jitter(steps: Array) -> float:
    """Return the rms deviation of the steps from their median, relative to it, with gaps left out."""
    median = np.median(steps)
    return float(np.sqrt(np.mean((steps[steps <= MAX_GAP_STEPS * median] - median) ** 2)) / median)


def _whole_steps(ratio: Array) -> Array:
    """Return the number of sampling periods of each step (in medians): more than one where samples were lost."""
    # with regular steps a lost sample shows at 1.5 medians; with jitter only at a larger step
    is_regular = np.mean(np.abs(ratio - 1) < 0.1) >= _MIN_REGULAR_SHARE
    return np.asarray(np.where(ratio > (1.5 if is_regular else 2.5), np.round(ratio), 1.0))


def _noise_ratio(log: Log, t: Array) -> float:
    """Return the noise of the positions on the axis t over that at the stamps, where both differ most."""
    moving = np.ptp(log.q, axis=0) > 0
    if not moving.any():
        return 1.0
    ratio = noise_sigma(t, log.q[:, moving]) / noise_sigma(log.t, log.q[:, moving])
    return float(ratio[np.argmax(np.abs(np.log(ratio)))])


def split_gaps(log: Log) -> tuple[Log, ...]:
    """Return the uninterrupted pieces of a log, cut where a step is over 12 times the median step.

    Pieces of fewer than ``MINIMUM_SAMPLES`` samples are left out, so that the result may be empty.
    """
    # cut at the gaps, and leave out pieces that are too short to smooth
    edges = [0, *(_long_steps(log) + 1), len(log)]
    if len(edges) == 2:
        return (log,)
    pieces = [slice(a, b) for a, b in pairwise(edges) if b - a >= MINIMUM_SAMPLES]
    return tuple(log.rows(rows, f"{log.source} part {k}") for k, rows in enumerate(pieces, 1))


def _long_steps(log: Log) -> NDArray[np.intp]:
    steps = np.diff(log.t)
    return np.flatnonzero(steps > MAX_GAP_STEPS * np.median(steps))


def step_findings(log: Log) -> Iterator[Finding]:
    """Yield an error where the log is too short or a gap too long for a smoother, a warning where its steps vary."""
    steps = np.diff(log.t)
    median = float(np.median(steps)) if len(steps) else 0.0
    if len(log) < MINIMUM_SAMPLES:
        yield Finding(channel_notes.TooFewSamples(len(log), MINIMUM_SAMPLES, median))
    long_steps = _long_steps(log)
    if len(long_steps):
        length, after = float(steps[long_steps[0]]), float(log.t[long_steps[0]])
        yield Finding(channel_notes.LongGap(length, after, length / median, len(long_steps)))
    jitter = _relative_jitter(steps)
    if jitter > _MAX_JITTER:
        yield Finding(channel_notes.UnevenSteps(jitter, median, float(steps.min()), float(steps.max())))


def stamp_findings(facts: Timing) -> Iterator[Finding]:
    """Yield which time axis to use, that with less noise in the positions, and how many samples are missing."""
    best = min(facts.even, facts.slots)
    if best < _MAX_NOISE_RATIO and facts.jitter > _MAX_ROUNDING_JITTER:
        # equal spacing would shift all that follows a loss
        rounded = facts.missing > 0 and facts.slots < 0.9 * facts.even
        rate, step = (None, facts.step) if rounded else (facts.rate, None)
        yield Finding(channel_notes.StampsJitter(facts.jitter, 1 / best, rate, step))
    elif facts.jitter > _MAX_JITTER:
        yield Finding(channel_notes.SamplingJitter(facts.jitter, facts.even if facts.even > 1.02 else None))
    if facts.missing:
        share = facts.missing / (facts.samples + facts.missing)
        severity = Severity.WARNING if share > _MAX_LOST_SHARE else Severity.INFO
        yield Finding(channel_notes.LostSamples(facts.missing, share, facts.longest / facts.step), severity=severity)


TIME_FACTORS = (1e-3, 1e-6, 1e-9, 1e3, 1e6, 1e9)
USUAL_RATES = (20.0, 5e4)  # Hz, of recordings of robots
MIN_RATE, MAX_RATE = 6.0, 1e5  # Hz: beyond, a unit is suspected
USUAL_SPEEDS = (0.01, 40.0)  # rad/s, m/s, of motions that show dynamics
MAX_SPAN, MAX_SPEED = 20.0, 20.0  # m, m/s: beyond, a length is in millimetres
MIN_ORDERED_SPAN = 0.1  # rad, m: noise alone does not span it
MAX_RADIAN_SPAN = 0.3  # rad: where all joints move less, their angles may be radians declared as degrees
MAX_DEGREE_ERROR_RATIO = 0.95  # of the error: a smaller one tells the unit
MAX_JOINT_DEGREE_ERROR_RATIO = 0.5  # the same of one joint, which may well move less than others
FIT_SAMPLES = 3000  # of all motions, for a fit that only compares


def time_unit_findings(log: Log) -> Iterator[Finding]:
    """Yield an error where rate and speeds are implausible, and another unit of time makes both usual."""
    step = float(np.median(np.diff(log.t)))
    speed = float(np.max([percentile_speed(log.t, q) for q in log.q.T]))
    if MIN_RATE <= 1 / step <= MAX_RATE or USUAL_SPEEDS[0] * 5 <= speed <= USUAL_SPEEDS[1]:
        return
    for factor in TIME_FACTORS:
        is_usual = USUAL_RATES[0] <= 1 / (step * factor) <= USUAL_RATES[1]
        if is_usual and USUAL_SPEEDS[0] <= speed / factor <= USUAL_SPEEDS[1]:
            yield Finding(channel_notes.WrongTimeUnit(1 / step, speed, factor))
            return


def order_findings(log: Log) -> Iterator[Finding]:
    """Yield an error where successive positions of all joints are not related; noise at rest is no motion."""
    moving = log.q[:, np.ptp(log.q, axis=0) > MIN_ORDERED_SPAN]
    # in units of its variance the mean squared step is 2 for independent rows, and nearly 0 for a motion
    if moving.size and (np.mean(np.diff(moving, axis=0) ** 2, axis=0) > np.var(moving, axis=0)).all():
        yield Finding(channel_notes.UnorderedRows())


def percentile_speed(t: Array, q: Array, samples: int = 5) -> float:
    """Return the 99th percentile of the speed over several samples, as the difference of two is mostly noise."""
    lag = min(max(samples, 1), len(t) - 1)
    return float(np.percentile(np.abs(q[lag:] - q[:-lag]) / (t[lag:] - t[:-lag]), 99))


def length_unit_findings(joint: str, t: Array, q: Array) -> Iterator[Finding]:
    """Yield a warning where a sliding joint moves as far, or as fast, as if it were in millimetres."""
    span, speed = float(np.ptp(q)), percentile_speed(t, q)
    if span > MAX_SPAN or speed > MAX_SPEED:
        yield Finding(channel_notes.PerhapsMillimetres(span, speed), joint)


def radian_findings(regression: Regression) -> Iterator[Finding]:
    """Yield where small angles explain the torque far better when taken as radians declared as degrees.

    They are those of all joints or, where others move more, those of a joint.
    """
    angles = np.array([joint.kind == "revolute" for joint in regression.model.joints])
    spans: Array = np.max([np.ptp(motion.q, axis=0) for motion in regression.motions], axis=0)
    is_small = angles & (spans <= MAX_RADIAN_SPAN)
    if not is_small.any():
        return
    before, others_move = rms_error(regression), bool((is_small != angles).any())
    for joints in np.diag(is_small)[is_small] if others_move else [angles]:
        factor = np.where(joints, 180 / np.pi, 1.0)
        # undo the conversion of degrees to rad in position and derivatives
        large = tuple(replace(x, q=x.q * factor, dq=x.dq * factor, ddq=x.ddq * factor) for x in regression.motions)
        after = rms_error(replace(regression, motions=large))
        if after < (MAX_JOINT_DEGREE_ERROR_RATIO if others_move else MAX_DEGREE_ERROR_RATIO) * before:
            note = log_notes.PerhapsRadians(float(spans[joints].max()), before, after, others_move)
            yield Finding(note, regression.model.joints[int(np.argmax(joints))].name if others_move else None)


def thin_regression(model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None) -> Regression:
    """Return the regression of a few samples of the motions, enough to compare fits."""
    thinned_motions = thin_motions(motions, max(FIT_SAMPLES, 3 * len(model.parameters)))
    return Regression(model, thinned_motions, Selection(min_speed=min_speed))


def joint_errors(regression: Regression) -> Array:
    """Return the relative error (n), in %, of least squares that weights each joint by the size of its torque.

    Zero for a joint without torque.
    """
    factors = regression.triangular_factors
    size = np.square(factors.factors[:, :, -1]).sum(axis=1)
    size[size == 0] = np.inf
    theta = solve_least_squares(factors.stack(1 / np.sqrt(size))).value
    return np.asarray(100.0 * np.sqrt(factors.residual(theta) / size))


def rms_error(regression: Regression) -> float:
    """Return the root mean square of ``joint_errors`` over the joints that have a torque."""
    torque = regression.triangular_factors.factors[:, :, -1].any(axis=1)
    return float(np.sqrt(np.square(joint_errors(regression)).sum() / max(int(np.count_nonzero(torque)), 1)))
