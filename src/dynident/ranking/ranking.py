"""What a comparison has found: every combination with its errors, which is best, and which are as good by chance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Finding, Use, brief, listed
from dynident.identification import SubstituteUsed
from dynident.ranking.candidates import Candidate, Combination
from dynident.ranking.differences import EXACT, LEVEL
from dynident.ranking.rows import Outcome

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Absent", "Ranked", "Ranking", "TruthFigures", "mean_of"]

Array = NDArray[np.float64]
CONTRARY = 1.1  # times the error of another in cross-validation, from which on the best is contradicted
Basis = Literal["validation", "train"]
SLIGHT = 0.01  # of the least error: a difference that no use of a model shows
SOON = 0.5  # s that make no difference: the first of a process takes longer by this


@dataclass(frozen=True, eq=False)
class TruthFigures:
    """How far an estimate is from true base parameters (r): their ``error`` (r) and ``std`` (r), nan where not known.

    ``relative`` is the median size of the errors in % of the true values, ``over_bound`` their rms in units of the
    least standard deviation that any unbiased method can reach (about 1 where the method reaches it), ``covered`` how
    many of the ``count`` intervals of 95 % hold the truth.
    """

    error: Array
    std: Array
    relative: float
    over_bound: float
    covered: int
    count: int

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Ranked:
    """A ``combination`` with what became of it, an ``Outcome`` with its ``reason`` where there is no estimate.

    Errors are relative to the unfiltered torque, in %, by joint: of the logs ``held_out``, of the same with the motion
    of the configured smoother (``same_motion``), which differ by the parameters alone, of the ``training``, and
    ``cross_validated``, nan where not known. ``error`` is the geometric mean over joints of the first, or of the last
    where no log is held out, ``overall`` that of the torques of all joints together. ``interval`` are the ends of the
    95 % interval of its difference to that of the best, ``p_value`` is that of being as good as any other,
    ``cross_p_value`` the same in cross-validation, where held-out logs rank. ``condition`` is that of the scaled
    regressor, ``eigenvalue`` the smallest one of the pseudo-inertias (below 0: no physical body; None: no bodies).
    Seconds are those of smoothing all logs, of the estimate, of the cross-validation.
    """

    combination: Combination
    outcome: Outcome
    reason: str = ""
    error: float = math.nan
    overall: float = math.nan
    held_out: Mapping[str, float] = field(default_factory=dict)
    same_motion: Mapping[str, float] = field(default_factory=dict)
    training: Mapping[str, float] = field(default_factory=dict)
    cross_validated: Mapping[str, float] = field(default_factory=dict)
    interval: tuple[float, float] = (math.nan, math.nan)
    p_value: float = math.nan
    cross_p_value: float = math.nan
    condition: float = math.nan
    eigenvalue: float | None = None
    seconds_smoothing: float = math.nan
    seconds_estimate: float = math.nan
    seconds_validation: float = math.nan
    notes: tuple[str, ...] = ()
    truth: TruthFigures | None = None

    __repr__ = brief

    @property
    def seconds(self) -> float:
        """Seconds of the smoothing and the estimate."""
        return self.seconds_smoothing + self.seconds_estimate

    def takes_longer(self, seconds: float) -> bool:
        """Whether it takes more than twice so many seconds, and half a second more."""
        return self.seconds > max(2.0 * seconds, seconds + SOON)

    def judged(self, basis: Basis) -> Mapping[str, float]:
        """Return the errors (%) by joint that combinations are ranked by."""
        return self.held_out if basis == "validation" else self.cross_validated

    @property
    def physical(self) -> bool:
        """Whether no body is known to be impossible."""
        return self.eigenvalue is None or self.eigenvalue > 0

    @property
    def worse(self) -> bool:
        """Whether it is worse than another by more than chance."""
        return self.p_value < LEVEL


@dataclass(frozen=True)
class Absent:
    """An estimator, or a smoother where that is empty, that does not apply to these logs, and why."""

    smoother: str
    estimator: str
    reason: str


@dataclass(frozen=True, eq=False)
class Ranking:
    """Smoothers and estimators on the same data: all ``rows``, the best first, then those without an estimate.

    ``basis`` is what they are ranked by: logs that are held out ("validation") or, without any, the cross-validation of
    the training ("train"), which has so many ``folds``. ``absent`` does not apply. ``shares`` are the samples (%) of
    each log that all have in common, ``kept`` those (%) of all logs that each smoother keeps. ``block`` is the time (s)
    of the blocks that are drawn to tell differences from chance, ``blocks`` how many such there are, ``told`` whether
    these are enough. ``parameters`` are base parameters whose truth is known, with their ``units``. ``smoothers`` are
    as used, ``estimators`` as given. ``computed`` is the number of new rows; others were known. ``repeats`` are
    held-out logs, each with one of the training whose motion it repeats. ``findings`` of the checks forbid the use of
    any model of these logs, whichever is ahead, or are about the controllers with which some estimators simulate.
    ``offsets`` are the time offsets (s) by smoother.
    """

    name: str
    joints: tuple[str, ...]
    basis: Basis
    rows: tuple[Ranked, ...]
    absent: tuple[Absent, ...]
    shares: Mapping[str, float]
    kept: Mapping[str, float]
    block: float
    blocks: float
    told: bool
    folds: int
    parameters: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    smoothers: tuple[Candidate, ...] = ()
    estimators: tuple[Candidate, ...] = ()
    computed: int = 0
    repeats: tuple[tuple[str, str], ...] = ()
    findings: tuple[Finding, ...] = ()
    offsets: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        few = listed((f"{one.combination.name} {one.error:.3g} %" for one in self.ranked), 3)
        return f"<Ranking of {len(self.ranked)} combinations on {self.name}: {few or 'none has an estimate'}>"

    @property
    def forbidding(self) -> tuple[Finding, ...]:
        """The findings that forbid the use of any model."""
        return tuple(one for one in self.findings if one.forbids is Use.CONTROL)

    @cached_property
    def ranked(self) -> tuple[Ranked, ...]:
        """The combinations that have an error, the best first."""
        return tuple(one for one in self.rows if math.isfinite(one.error))

    @cached_property
    def substituted(self) -> tuple[str, ...]:
        """The smoothers in whose place another one smooths logs that are held out."""
        lacking = (one for one in self.rows if SubstituteUsed.__name__ in one.notes)
        return tuple(dict.fromkeys(one.combination.smoother for one in lacking))

    @cached_property
    def failed(self) -> tuple[Ranked, ...]:
        """Those that have none."""
        return tuple(one for one in self.rows if not math.isfinite(one.error))

    @property
    def best(self) -> Ranked | None:
        """The combination with the least error; None where none has any."""
        return self.ranked[0] if self.ranked else None

    @cached_property
    def within(self) -> tuple[Ranked, ...]:
        """Those that are not worse than the best by more than chance; the best alone where that is not known."""
        return tuple(one for one in self.ranked if not one.worse) if self.told else self.ranked[:1]

    def hardly_worse(self, one: Ranked) -> bool:
        """Whether a combination is worse by more than chance, but its error surely by less than 1 % of the least."""
        return self.told and one.worse and one.interval[1] < SLIGHT * self.ranked[0].error

    @cached_property
    def as_good(self) -> tuple[Ranked, ...]:
        """Those that are as good for any use: ``within`` chance of the best, and those hardly worse."""
        return tuple(one for one in self.ranked if one in self.within or self.hardly_worse(one))

    @cached_property
    def rival(self) -> Ranked | None:
        """The best in cross-validation, where that contradicts the held-out logs: there the best on these is worse, by
        more than chance and 10 %, and loses more than it is ahead here; None where it does not."""
        best = self.best
        if self.basis == "train" or best is None or not best.cross_p_value < LEVEL:
            return None
        crossed = [one for one in self.ranked if math.isfinite(one.cross_p_value)]
        first = min(crossed, key=lambda one: mean_of(one.cross_validated))
        loss = mean_of(best.cross_validated) / mean_of(first.cross_validated)
        return first if loss > max(CONTRARY, first.error / best.error) else None

    @cached_property
    def choice(self) -> Ranked | None:
        """Which to take of those that are as good as the best: one whose bodies are possible and which converged, where
        there is any, and of these the fastest; times within a factor of two, or half a second, count as equal: of
        those it is that of the configuration, or else the one with the least error. Where there is a ``rival``,
        only those count that cross-validation does not contradict: there may be none."""
        some = list(self.as_good)
        if self.rival is not None:
            most = CONTRARY * mean_of(self.rival.cross_validated)
            some = [one for one in some if mean_of(one.cross_validated) <= most]
        if not some:
            return None
        good = [one for one in some if one.physical and one.outcome is Outcome.OK]
        some = good or [one for one in some if one.physical] or some
        fast = min(one.seconds for one in some)
        quick = [one for one in some if not one.takes_longer(fast)]
        return next((one for one in quick if one.combination.own), quick[0])

    @property
    def own(self) -> Ranked | None:
        """The combination of the configuration."""
        return next((one for one in self.rows if one.combination.own), None)

    def frame(self) -> pl.DataFrame:
        """Return a table, one row per combination: smoother, estimator, own, status, reason, error (%), that of all
        joints together, the difference to the best with the ends of its interval, p_value, worse, errors (%, geometric
        mean over joints) of the same motion, cross-validated and of the training, condition, eigenvalue, seconds,
        notes, and ``held_out.JOINT`` (%) by joint; null where not known.
        """
        import polars as pl

        rows = []
        least = self.best.error if self.best else math.nan
        for one in self.rows:
            row = {
                "smoother": one.combination.smoother, "estimator": one.combination.estimator,
                "own": one.combination.own, "status": one.outcome.value, "reason": one.reason, "error": one.error,
                "overall": one.overall,
                "difference": one.error - least, "lower": one.interval[0], "upper": one.interval[1],
                "p_value": one.p_value, "worse": one.worse, "same_motion": mean_of(one.same_motion),
                "cross_validated": mean_of(one.cross_validated), "training": mean_of(one.training),
                "condition": one.condition, "eigenvalue": one.eigenvalue,
                "seconds": one.seconds, "notes": ", ".join(one.notes),
            }  # fmt: skip
            rows.append(row | {f"held_out.{joint}": one.held_out.get(joint) for joint in self.joints})
        frame = pl.DataFrame(rows, schema_overrides={"eigenvalue": pl.Float64}, infer_schema_length=None)
        return frame.with_columns(pl.selectors.float().fill_nan(None))


def mean_of(by_joint: Mapping[str, float]) -> float:
    """Return the geometric mean over joints of what is known, nan where nothing is."""
    known = np.array([value for value in by_joint.values() if math.isfinite(value)])
    return float(np.exp(np.log(np.maximum(known, 100.0 * EXACT)).mean())) if len(known) else math.nan
