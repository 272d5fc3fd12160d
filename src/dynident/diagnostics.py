"""What a log says of itself, before any model: gaps, jitter, dead or saturated channels, wrong units.

Pure functions of a ``Log``. An error is a log that would give wrong numbers, a warning one to look at.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError
from dynident.log import Log

__all__ = ["MINIMUM_SAMPLES", "Finding", "check", "require", "split_gaps"]

Array = NDArray[np.float64]

MINIMUM_SAMPLES = 30
"""Fewest samples of a log that are worth smoothing."""

_GAP = 12.0  # x the median step: a robot's scheduler may lose a few samples, a smoother bridges those
_JITTER = 0.1  # rms of the steps about their median, as a fraction of it
_RANGE = 4 * np.pi  # rad: joints of arms seldom turn further from stop to stop
_SPEED = 40.0  # rad/s: no arm moves its joints so fast
_SPEED_LAG = 0.02  # s: over this time position noise is small beside 40 rad/s
_SATURATED = 0.01  # fraction of samples at exactly the extreme value
_COARSE = 10.0  # median step in units of the resolution below which quantisation shapes the noise


@dataclass(frozen=True)
class Finding:
    """One remark on a log: ``severity``, the ``joint`` it concerns (None: all of them), and words with the cure."""

    severity: Literal["error", "warning"]
    joint: str | None
    message: str

    def __str__(self) -> str:
        return self.message if self.joint is None else f"joint {self.joint!r}: {self.message}"


def check(
    log: Log, kinds: Mapping[str, str], multi_turn: Set[str] = frozenset(), *, torque: bool = True
) -> tuple[Finding, ...]:
    """Return all findings on a log, those on time first, then joint by joint.

    ``kinds`` maps each joint of the log to "revolute" or "prismatic"; joints named in ``multi_turn`` may turn
    without end. ``torque`` False leaves the torques alone. Raises InputError where a joint of the log has no kind.
    """
    missing = [name for name in log.joints if name not in kinds]
    if missing:
        raise InputError(f"{log.source}: joint {missing[0]!r} has no kind; say revolute or prismatic.")
    findings = [*_samples(log), *_gaps(log), *_jitter(log)]
    for j, name in enumerate(log.joints):
        q, tau = log.q[:, j], log.tau[:, j]
        turns = kinds[name] == "revolute" and name not in multi_turn
        found = [*_still(q), *(_degrees(log.t, q) if turns else ()), *_quantised(q), *(_torque(tau) if torque else ())]
        findings += [replace(finding, joint=name) for finding in found]
    return tuple(findings)


def require(findings: Iterable[Finding], source: str) -> None:
    """Raise InputError with every finding that is an error, one a line; return where there is none."""
    errors = [str(finding) for finding in findings if finding.severity == "error"]
    if errors:
        raise InputError(f"{source}: " + "\n  ".join(errors))


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
    return np.flatnonzero(steps > _GAP * np.median(steps))


def _samples(log: Log) -> Iterator[Finding]:
    if len(log) < MINIMUM_SAMPLES:
        yield Finding(
            "error",
            None,
            f"only {len(log)} samples; at least {MINIMUM_SAMPLES} are needed: widen the window or record longer.",
        )


def _gaps(log: Log) -> Iterator[Finding]:
    long = _long_steps(log)
    if len(long):
        steps, first = np.diff(log.t), long[0]
        yield Finding(
            "error",
            None,
            f"a gap of {steps[first]:.4g} s after t = {log.t[first]:.6g} s "
            f"({steps[first] / np.median(steps):.0f} times the median step; {len(long)} such gaps in all). "
            "Leave it out with a window, or set `gaps: split` to smooth each piece on its own.",
        )


def _jitter(log: Log) -> Iterator[Finding]:
    steps = np.diff(log.t)
    median = float(np.median(steps))
    regular = steps[steps <= _GAP * median]
    jitter = float(np.sqrt(np.mean((regular - median) ** 2))) / median
    if jitter > _JITTER:
        yield Finding(
            "warning",
            None,
            f"the time steps vary by {100 * jitter:.0f} % about {median:.4g} s (from {steps.min():.3g} to "
            f"{steps.max():.3g} s). Where the clock that stamps is not the one that samples, this is position noise.",
        )


def _still(q: Array) -> Iterator[Finding]:
    levels = len(np.unique(q))
    if levels <= 3:
        yield Finding(
            "warning",
            None,
            f"the position never moves ({levels} distinct values near {q[0]:.6g}): nothing about this joint's own "
            "motion can be identified. Look whether the right column is named, or take another window.",
        )


def _degrees(t: Array, q: Array) -> Iterator[Finding]:
    span, speed = float(np.ptp(q)), _peak_speed(t, q)
    if span > _RANGE or speed > _SPEED:
        yield Finding(
            "error",
            None,
            f"the position spans {span:.4g} rad at up to {speed:.4g} rad/s, more than an arm does; is it in degrees? "
            "Set `unit: deg`, or `multi_turn: true` in the joint's position channel if it does turn so.",
        )


def _peak_speed(t: Array, q: Array) -> float:
    """Return the 99th percentile of the speed over 20 ms: single samples are too noisy to judge by."""
    lag = int(np.clip(round(_SPEED_LAG / float(np.median(np.diff(t)))), 1, len(t) - 1))
    return float(np.percentile(np.abs(q[lag:] - q[:-lag]) / (t[lag:] - t[:-lag]), 99))


def _quantised(q: Array) -> Iterator[Finding]:
    steps = np.abs(np.diff(q))
    steps = steps[steps > 1e-9 * np.ptp(q)]  # shorter ones are rounding of the arithmetic
    if len(steps) < MINIMUM_SAMPLES:
        return
    resolution = float(steps.min())
    counts = steps / resolution
    on_grid = float(np.max(np.abs(counts - np.round(counts)))) < 0.05
    if on_grid and np.median(counts) < _COARSE:
        yield Finding(
            "warning",
            None,
            f"the position is quantised in steps of {resolution:.4g}, and most samples differ by fewer than "
            f"{_COARSE:.0f} of them: the error is not white noise, so check a noise level estimated from it.",
        )


def _torque(tau: Array) -> Iterator[Finding]:
    low, high = float(tau.min()), float(tau.max())
    if low == high:
        yield Finding(
            "warning",
            None,
            f"the torque is {low:.6g} throughout; look whether the right column is named and was recorded.",
        )
        return
    for extreme in (low, high):
        count = int(np.count_nonzero(tau == extreme))
        if extreme != 0 and count > max(10, _SATURATED * len(tau)):  # zero: an arm let go, not a limit
            yield Finding(
                "warning",
                None,
                f"{count} of {len(tau)} torques are exactly the extreme value {extreme:.6g}: saturated? "
                "A torque cut off at a limit biases the fit; leave these parts out with windows.",
            )
