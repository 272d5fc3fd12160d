"""The settings that are tuned by hand, all of them, as one value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from dynident.errors import ConfigError, choices
from dynident.regression import ParallelFilter
from dynident.smoothers import LONGEST_OFFSET

__all__ = ["LEAST", "MOST", "Tuning", "Window"]

LEAST, MOST = -6.0, 6.0  # log10(S/n): beyond, a spline interpolates, or is a straight line
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
        for one in self.degree:
            if not LEAST <= one <= MOST:
                raise ConfigError(
                    f"degree of smoothing, log10(S/n), is {one:g}; give a number from {LEAST:g} to {MOST:g}."
                )
        for one in self.min_speed:
            if not 0.0 <= one < math.inf:
                raise ConfigError(f"minimum speed is {one:g}; give a number of at least 0, in rad/s or m/s.")
        if not abs(self.time_offset) <= LONGEST_OFFSET:
            raise ConfigError(f"time offset is {self.time_offset:g} s; give at most {LONGEST_OFFSET:g} s in size.")
        for name, start, stop in self.excluded:
            if not (math.isfinite(start) and math.isfinite(stop) and start < stop):
                raise ConfigError(
                    f"excluded window of {name!r}: {start:g} to {stop:g} s; it must stop after it starts."
                )

    def with_degree(self, degree: float, joint: int | None = None) -> Tuning:
        """Return the tuning with a degree of smoothing of one joint, by its place, or of all."""
        places = range(len(self.degree)) if joint is None else (joint,)
        return replace(self, degree=tuple(degree if j in places else was for j, was in enumerate(self.degree)))

    def with_terms(self, joint: int, kinds: Sequence[str]) -> Tuning:
        """Return the tuning with the kinds of terms of a joint, by its place."""
        return replace(self, terms=tuple(tuple(kinds) if j == joint else was for j, was in enumerate(self.terms)))

    def excluding(self, log: str, start: float, stop: float) -> Tuning:
        """Return the tuning with a window of a log (s) excluded too, joined with those that it meets."""
        spans = sorted([(a, b) for name, a, b in self.excluded if name == log] + [(start, stop)])
        joined = [spans[0]]
        for a, b in spans[1:]:
            if a <= joined[-1][1]:
                joined[-1] = joined[-1][0], max(b, joined[-1][1])
            else:
                joined.append((a, b))
        others = tuple(one for one in self.excluded if one[0] != log)
        return replace(self, excluded=(*others, *((log, a, b) for a, b in joined)))

    def windows(self, log: str) -> tuple[tuple[float, float], ...]:
        """Return the windows (start, stop; s) of a log that are excluded."""
        return tuple((start, stop) for name, start, stop in self.excluded if name == log)

    def check(
        self, joints: Sequence[str], logs: Sequence[str], kinds: Sequence[str], estimators: Sequence[str]
    ) -> None:
        """Raise ConfigError where the tuning does not fit these joints, logs, kinds of terms and estimators."""
        for name in ("degree", "terms", "min_speed"):
            if len(given := getattr(self, name)) != len(joints):
                raise ConfigError(f"{name} has {len(given)} entries for {len(joints)} joints ({', '.join(joints)}).")
        named = [
            ("unfitted", "joint", self.unfitted, joints),
            ("estimator", "estimator", (self.estimator,), estimators),
        ]
        named.append(("excluded", "log", tuple(one for one, _, _ in self.excluded), logs))
        named.append(("terms", "kind of terms", tuple(kind for some in self.terms for kind in some), kinds))
        for where, what, names, known in named:
            for name in names:
                if name not in known:
                    raise ConfigError(f"{where}: there is no {what} {name!r}; {choices(name, known)}")
        if set(joints) <= set(self.unfitted):
            raise ConfigError("unfitted: names every joint, so that nothing is left to fit; leave one out.")
