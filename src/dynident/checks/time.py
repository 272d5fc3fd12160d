"""Checks of the time stamps of a log: gaps, lost samples, and whether the stamps or the sampling jitter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.checks import notes
from dynident.checks.finding import Finding, Topic
from dynident.errors import Severity
from dynident.log import Log
from dynident.splines import noise_sigma

__all__ = [
    "GAP",
    "MINIMUM_SAMPLES",
    "Timing",
    "gaps",
    "jitter",
    "lost",
    "respaced",
    "samples",
    "split_gaps",
    "stamps",
    "timing",
]

Array = NDArray[np.float64]

MINIMUM_SAMPLES = 30
"""Least number of samples of a log that can be smoothed."""

GAP = 12.0  # x the median step: a smoother bridges the few samples that a robot's scheduler may lose
_JITTER = 0.1  # rms of the steps about their median, as a fraction of it
_REGULAR = 0.9  # share of steps within 10 % of the median from which on a step of 1.5 medians is a lost sample
_MANY = 0.01  # share of lost samples to warn of
_BETTER = 0.8  # ratio of noises below which one time axis is clearly better
_EVEN = 1e-6  # jitter below which stamps and equal spacing are the same
_ROUNDED = 1e-4  # jitter that stamps of few digits have
_AWAY, _PARTS = 0.5, 20  # steps that the stamps may be from equal spacing, in the median of parts of the log


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
    jitter, unbroken = _rms(steps), bool((steps <= GAP * median).all())
    whole = _whole_steps(steps / median)
    places = np.append(0.0, np.cumsum(whole))
    slope = float(np.polyfit(places, log.t - log.t[0], 1)[0]) if unbroken and len(log) > 2 else median
    even = slots = 1.0
    if jitter > _EVEN and len(log) >= MINIMUM_SAMPLES and unbroken:
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
        missing=int((whole - 1).sum()) if unbroken else 0,
        even=even,
        slots=slots,
    )


def respaced(log: Log, *, always: bool = False) -> tuple[Log, notes.EquallySpaced | None]:
    """Return the log on equal spacing where its positions are less noisy on it than at the stamps, and what was done.

    The line through the stamps gives the times; samples that were lost keep their place. Where the stamps leave the
    line for long, which a late stamp does not, they have true gaps and are kept. ``always``: whatever the noise.
    """
    t, steps = log.t, np.diff(log.t)
    jitter = _rms(steps)
    if jitter <= (_EVEN if always else _ROUNDED) or len(log) < MINIMUM_SAMPLES or len(_long_steps(log)):
        return log, None
    places = np.append(0.0, np.cumsum(_whole_steps(steps / float(np.median(steps)))))
    lost = int(places[-1]) + 1 - len(log)
    axes = [_line(t, places), *([_line(t, np.arange(len(log)))] if lost and not always else ())]
    ratios = [_noise_ratio(log, one) if always or _follows(t, one) else 1.0 for one in axes]
    best = int(np.argmin(ratios))
    if not always and ratios[best] >= _BETTER:
        return log, None
    lost *= best == 0
    note = notes.EquallySpaced(jitter, 1 / ratios[best], (len(t) - 1 + lost) / float(np.ptp(axes[best])), lost)
    return replace(log, t=axes[best]), note


def _line(t: Array, places: NDArray[Any]) -> Array:
    """Return the straight line (N) through the stamps at these places."""
    middle, centred = places.mean(), t - t.mean()
    slope = float((places - middle) @ centred / np.square(places - middle).sum())
    return np.asarray(t.mean() + slope * (places - middle))


def _follows(t: Array, line: Array) -> bool:
    """Whether the stamps stay near the line, but for single ones."""
    away = [float(np.median(part)) for part in np.array_split(t - line, _PARTS)]
    return float(np.ptp(away)) < _AWAY * float(np.median(np.diff(t)))


def _rms(steps: Array) -> float:
    """Return the rms deviation of the steps from their median, as a fraction of it, without the gaps."""
    median = np.median(steps)
    return float(np.sqrt(np.mean((steps[steps <= GAP * median] - median) ** 2)) / median)


def _whole_steps(ratio: Array) -> Array:
    """Return how many sampling periods each step (in medians) spans: more than one where samples were lost."""
    calm = np.mean(np.abs(ratio - 1) < 0.1) >= _REGULAR
    return np.asarray(np.where(ratio > (1.5 if calm else 2.5), np.round(ratio), 1.0))


def _noise_ratio(log: Log, t: Array) -> float:
    """Return the noise of the positions on the time axis t over that at the stamps, where it differs most from one."""
    moving = np.ptp(log.q, axis=0) > 0
    if not moving.any():
        return 1.0
    ratio = noise_sigma(t, log.q[:, moving]) / noise_sigma(log.t, log.q[:, moving])
    return float(ratio[np.argmax(np.abs(np.log(ratio)))])


def split_gaps(log: Log) -> tuple[Log, ...]:
    """Return the uninterrupted pieces of a log, cut where a step is over 12 times the median step.

    Pieces of fewer than ``MINIMUM_SAMPLES`` samples are left out, so that the result may be empty.
    """
    edges = [0, *(_long_steps(log) + 1), len(log)]
    if len(edges) == 2:
        return (log,)
    pieces = [slice(a, b) for a, b in pairwise(edges) if b - a >= MINIMUM_SAMPLES]
    return tuple(log.rows(rows, f"{log.source} part {k}") for k, rows in enumerate(pieces, 1))


def _long_steps(log: Log) -> NDArray[np.intp]:
    steps = np.diff(log.t)
    return np.flatnonzero(steps > GAP * np.median(steps))


def samples(log: Log) -> Iterator[Finding]:
    """Yield an error where the log is too short."""
    if len(log) < MINIMUM_SAMPLES:
        step = float(np.median(np.diff(log.t))) if len(log) > 1 else 0.0
        yield Finding(Severity.ERROR, None, notes.TooFewSamples(len(log), MINIMUM_SAMPLES, step), Topic.SAMPLES)


def gaps(log: Log) -> Iterator[Finding]:
    """Yield an error where a gap is too long for a smoother."""
    long = _long_steps(log)
    if len(long):
        steps, first = np.diff(log.t), long[0]
        length = float(steps[first])
        note = notes.LongGap(length, float(log.t[first]), length / float(np.median(steps)), len(long))
        yield Finding(Severity.ERROR, None, note, Topic.GAP)


def jitter(log: Log) -> Iterator[Finding]:
    """Yield a warning where the time steps vary much."""
    steps = np.diff(log.t)
    median, jitter = float(np.median(steps)), _rms(steps)
    if jitter > _JITTER:
        note = notes.UnevenSteps(jitter, median, float(steps.min()), float(steps.max()))
        yield Finding(Severity.WARNING, None, note, Topic.JITTER)


def stamps(facts: Timing) -> Iterator[Finding]:
    """Yield which time axis to use: the stamps, or equal spacing, whichever leaves less noise in the positions."""
    best = min(facts.even, facts.slots)
    if best < _BETTER and facts.jitter > _ROUNDED:
        # equal spacing would shift all that follows a loss
        rounded = facts.missing > 0 and facts.slots < 0.9 * facts.even
        rate, step = (None, facts.step) if rounded else (facts.rate, None)
        yield Finding(Severity.WARNING, None, notes.StampsJitter(facts.jitter, 1 / best, rate, step), Topic.STAMPS)
    elif facts.jitter > _JITTER:
        note = notes.SamplingJitter(facts.jitter, facts.even if facts.even > 1.02 else None)
        yield Finding(Severity.INFO, None, note, Topic.JITTER)


def lost(facts: Timing) -> Iterator[Finding]:
    """Yield the number of samples missing between the others."""
    if facts.missing:
        share = facts.missing / (facts.samples + facts.missing)
        severity = Severity.WARNING if share > _MANY else Severity.INFO
        note = notes.LostSamples(facts.missing, share, facts.longest / facts.step)
        yield Finding(severity, None, note, Topic.LOST)
