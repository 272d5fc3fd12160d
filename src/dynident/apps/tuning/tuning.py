"""The settings that are tuned by hand, as one value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

from dynident.motion.smoothers import MAX_TIME_OFFSET
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, choices

MIN_DEGREE, MAX_DEGREE = -6.0, 6.0  # log10(S/n): beyond, a spline interpolates, or is a straight line
Window = tuple[str, float, float]


@dataclass(frozen=True)
class Tuning:
    """Everything that can be set by hand, complete: nothing is relative to other settings. Hashable.

    For each of the n joints of the model, in its order: ``degree``, log10(S/n) of the smoothing spline, in terms of the
    noise of the positions; ``terms``, the kinds of terms beside the bodies, such as "coulomb"; ``min_speed`` (rad/s,
    m/s), 0 where all samples are fitted. ``estimator`` is a kind. ``excluded`` are windows (name of a log, start and
    stop in s of its time) that are neither fitted nor judged; ``unfitted`` the joints whose torque equation is not
    fitted. ``filter`` is the parallel filter; ``time_offset`` (s) how much later than the torque the positions are
    stamped. Raises ConfigError for a number out of range.
    """

    degree: tuple[float, ...]
    terms: tuple[tuple[str, ...], ...]
    min_speed: tuple[float, ...]
    estimator: str
    excluded: tuple[Window, ...] = ()
    unfitted: tuple[str, ...] = ()
    filter: ParallelFilter | None = None
    time_offset: float = 0.0

    def __post_init__(self) -> None:
        for number in self.degree:
            if not MIN_DEGREE <= number <= MAX_DEGREE:
                raise ConfigError(
                    f"degree of smoothing, log10(S/n), is {number:g}; give a number from {MIN_DEGREE:g} to "
                    f"{MAX_DEGREE:g}."
                )
        for number in self.min_speed:
            if not 0.0 <= number < math.inf:
                raise ConfigError(f"minimum speed is {number:g}; give a number of at least 0, in rad/s or m/s.")
        if not abs(self.time_offset) <= MAX_TIME_OFFSET:
            raise ConfigError(f"time offset is {self.time_offset:g} s; give at most {MAX_TIME_OFFSET:g} s in size.")
        for name, start, stop in self.excluded:
            if not (math.isfinite(start) and math.isfinite(stop) and start < stop):
                raise ConfigError(
                    f"excluded window of {name!r}: {start:g} to {stop:g} s; it must stop after it starts."
                )

    def with_degree(self, degree: float, joint: int | None = None) -> Tuning:
        """Return the tuning with a degree of smoothing for one joint, by its index, or for all."""
        degrees = (degree if joint in (None, j) else previous for j, previous in enumerate(self.degree))
        return replace(self, degree=tuple(degrees))

    def exclude(self, log: str, start: float, stop: float) -> Tuning:
        """Return the tuning with another excluded window of a log (s), merged with those that it overlaps."""
        spans = sorted([(a, b) for name, a, b in self.excluded if name == log] + [(start, stop)])
        joined = [spans[0]]
        for a, b in spans[1:]:
            if a <= joined[-1][1]:
                joined[-1] = joined[-1][0], max(b, joined[-1][1])
            else:
                joined.append((a, b))
        other_windows = tuple(window for window in self.excluded if window[0] != log)
        return replace(self, excluded=(*other_windows, *((log, a, b) for a, b in joined)))

    def windows(self, log: str) -> tuple[tuple[float, float], ...]:
        """Return the windows (start, stop; s) of a log that are excluded."""
        return tuple((start, stop) for name, start, stop in self.excluded if name == log)

    def check(
        self, joints: Sequence[str], logs: Sequence[str], kinds: Sequence[str], estimators: Sequence[str]
    ) -> None:
        """Raise ConfigError where the tuning does not fit these joints, logs, kinds of terms and estimators."""
        for name in ("degree", "terms", "min_speed"):
            if len(values := getattr(self, name)) != len(joints):
                raise ConfigError(f"{name} has {len(values)} entries for {len(joints)} joints ({', '.join(joints)}).")
        for where, noun, names, allowed in (
            ("unfitted", "joint", self.unfitted, joints),
            ("estimator", "estimator", (self.estimator,), estimators),
            ("excluded", "log", [log for log, _, _ in self.excluded], logs),
            ("terms", "kind of terms", chain(*self.terms), kinds),
        ):
            for name in names:
                if name not in allowed:
                    raise ConfigError(f"{where}: there is no {noun} {name!r}; {choices(name, allowed)}")
        if set(joints) <= set(self.unfitted):
            raise ConfigError("unfitted: names every joint, so that nothing is left to fit; leave one out.")
