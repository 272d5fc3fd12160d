"""The result of a comparison: every combination with its errors, which is best, and which are as good by chance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dynident.apps.ranking.config import Candidate, Combination
from dynident.apps.ranking.differences import MIN_RELATIVE_ERROR, SIGNIFICANCE_LEVEL, TrueParameters
from dynident.identification import SubstituteUsed
from dynident.motion.splines import NORMAL_95
from dynident.runtime import Finding, Noun, Use, join_names
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import Status

if TYPE_CHECKING:
    import polars as pl

MIN_CONTRADICTION_RATIO = 1.1  # times the error of another in cross-validation, from which on the best is contradicted
Basis = Literal["validation", "train"]
MAX_SLIGHT_SHARE = 0.01  # of the least error: a difference that no use of a model shows
START_UP_TIME = 0.5  # s that make no difference: the first of a process takes longer by this


class CombinationOutcome(StrEnum):
    """What became of a combination: an estimate, one that did not converge, or none.

    There is none where the log lacks what it needs, where the smoother leaves out too many samples, where it
    raised an error, took too long or too much memory, or its process died.
    """

    OK = "ok"
    UNSETTLED = "unsettled"
    NOT_APPLICABLE = "not applicable"
    TOO_FEW = "too few samples"
    FAILED = Status.FAILED.value
    TIMED_OUT = Status.TIMED_OUT.value
    OUT_OF_MEMORY = Status.OUT_OF_MEMORY.value
    DIED = Status.DIED.value


class TruthFigures(Noun):
    """Errors of an estimate of the true base parameters (r): ``error`` (r) and ``std`` (r), nan where not known.

    ``relative`` is the median size of the errors in % of the true values; ``over_bound`` their rms in units of
    the least standard deviation of any unbiased method (about 1 where the method reaches it); ``covered`` the
    number of the ``count`` intervals of 95 % that contain the truth.
    """

    error: Array
    std: Array
    relative: float
    over_bound: float
    covered: int
    count: int

    @classmethod
    def of(cls, truth: TrueParameters, value: Sequence[float], std: Sequence[float]) -> TruthFigures:
        """Return the errors of estimated values (r) with their standard errors (r)."""
        error, errors_std = np.array(value, dtype=float) - truth.value, np.array(std, dtype=float)
        with np.errstate(divide="ignore", invalid="ignore"):
            relative, scaled_error = 100.0 * np.abs(error / truth.value), error / truth.bound
        relative, scaled_error = (x[np.isfinite(x)] for x in (relative, scaled_error))
        median = float(np.median(relative)) if len(relative) else math.nan
        over_bound = float(np.sqrt(np.mean(scaled_error**2))) if len(scaled_error) else math.nan
        is_known = np.isfinite(error) & np.isfinite(errors_std)
        covered = int(np.sum(np.abs(error[is_known]) <= NORMAL_95 * errors_std[is_known]))
        return cls(error, errors_std, median, over_bound, covered, int(is_known.sum()))


class RankedCombination(Noun):
    """A ``combination`` with its ``outcome``, and the ``reason`` where there is no estimate.

    Errors are relative to the unfiltered torque, in %, by joint: of the ``held_out`` logs, of the same with the
    motion of the configured smoother (``same_motion``), which differ by the parameters alone, of the
    ``training``, and ``cross_validated``, nan where not known. ``error`` is the geometric mean over joints of the
    first, or of the last where no log is held out; ``overall`` is that of the torques of all joints together.
    ``interval`` are the ends of the 95 % interval of the difference to the best, ``p_value`` is that of being as
    good as any other, ``cross_p_value`` the same in cross-validation, where held-out logs rank. ``condition`` is
    that of the scaled regressor, ``eigenvalue`` the smallest one of the pseudo-inertias (below 0: no physical
    body; None: no bodies). Seconds are those of smoothing all logs, of the estimate, and of the cross-validation.
    """

    combination: Combination
    outcome: CombinationOutcome
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

    @property
    def seconds(self) -> float:
        """Seconds of the smoothing and the estimate."""
        return self.seconds_smoothing + self.seconds_estimate

    def takes_longer(self, seconds: float) -> bool:
        """Whether it takes more than twice so many seconds, and half a second more."""
        return self.seconds > max(2.0 * seconds, seconds + START_UP_TIME)

    def ranking_errors(self, basis: Basis) -> Mapping[str, float]:
        """Return the errors (%) by joint that combinations are ranked by."""
        return self.held_out if basis == "validation" else self.cross_validated

    @property
    def is_physical(self) -> bool:
        """Whether no body is known to be impossible."""
        return self.eigenvalue is None or self.eigenvalue > 0

    @property
    def is_worse(self) -> bool:
        """Whether it is worse than another by more than chance."""
        return self.p_value < SIGNIFICANCE_LEVEL


@dataclass(frozen=True)
class InapplicablePart:
    """An estimator, or a smoother where that is empty, that does not apply to these logs, and the reason."""

    smoother: str
    estimator: str
    reason: str


@dataclass(frozen=True, eq=False)
class Ranking:
    """A ranking of smoothers and estimators on the same data.

    ``rows`` are all combinations, the best first, then those without an estimate. ``basis`` is what they are
    ranked by: logs that are held out ("validation") or, without any, the cross-validation of the training
    ("train"), which has so many ``folds``. ``absent`` are parts that do not apply. ``shares`` are the samples (%)
    of each log that all have in common, ``kept_shares`` those (%) of all logs that each smoother keeps. ``block``
    is the time (s) of the blocks that are drawn to tell differences from chance, ``blocks`` how many such there
    are, ``has_enough_blocks`` whether these suffice. ``parameters`` are base parameters whose true values are
    known, with their ``units``. ``smoothers`` are as used, ``estimators`` as given. ``computed`` is the number of
    new rows; others were known. ``repeats`` are held-out logs, each with one of the training whose motion it
    repeats. ``findings`` of the checks forbid the use of any model of these logs, whichever is best, or are about
    the controllers with which some estimators simulate. ``offsets`` are the time offsets (s) by smoother.
    """

    name: str
    joints: tuple[str, ...]
    basis: Basis
    rows: tuple[RankedCombination, ...]
    absent: tuple[InapplicablePart, ...]
    shares: Mapping[str, float]
    kept_shares: Mapping[str, float]
    block: float
    blocks: float
    has_enough_blocks: bool
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
        leaders = join_names((f"{entry.combination.name} {entry.error:.3g} %" for entry in self.standings), 3)
        return f"<Ranking of {len(self.standings)} combinations on {self.name}: {leaders or 'none has an estimate'}>"

    @property
    def forbidding_findings(self) -> tuple[Finding, ...]:
        """The findings that forbid the use of any model."""
        return tuple(finding for finding in self.findings if finding.forbids is Use.CONTROL)

    @cached_property
    def standings(self) -> tuple[RankedCombination, ...]:
        """The combinations that have an error, the best first."""
        return tuple(entry for entry in self.rows if math.isfinite(entry.error))

    @cached_property
    def substituted_smoothers(self) -> tuple[str, ...]:
        """The smoothers that were replaced by another one on held-out logs."""
        with_substitute = (entry for entry in self.rows if SubstituteUsed.__name__ in entry.notes)
        return tuple(dict.fromkeys(entry.combination.smoother for entry in with_substitute))

    @cached_property
    def failures(self) -> tuple[RankedCombination, ...]:
        """The combinations without an error."""
        return tuple(entry for entry in self.rows if not math.isfinite(entry.error))

    @property
    def best(self) -> RankedCombination | None:
        """The combination with the least error; None where none has any."""
        return self.standings[0] if self.standings else None

    @cached_property
    def within_chance(self) -> tuple[RankedCombination, ...]:
        """The combinations that are not worse than the best by more than chance; the best alone where that is not
        known."""
        if not self.has_enough_blocks:
            return self.standings[:1]
        return tuple(entry for entry in self.standings if not entry.is_worse)

    def hardly_worse(self, entry: RankedCombination) -> bool:
        """Return whether a combination is worse by more than chance, but its error surely by less than 1 % of the
        least."""
        is_slight = entry.interval[1] < MAX_SLIGHT_SHARE * self.standings[0].error
        return self.has_enough_blocks and entry.is_worse and is_slight

    @cached_property
    def as_good(self) -> tuple[RankedCombination, ...]:
        """The combinations that are as good for any use: within chance of the best, or hardly worse."""
        return tuple(entry for entry in self.standings if entry in self.within_chance or self.hardly_worse(entry))

    @cached_property
    def rival(self) -> RankedCombination | None:
        """The best combination in cross-validation, where that contradicts the held-out logs, else None.

        It does where the best one on held-out logs is worse in cross-validation, by more than chance and 10 %, and
        loses more there than it is ahead here.
        """
        best = self.best
        if self.basis == "train" or best is None or not best.cross_p_value < SIGNIFICANCE_LEVEL:
            return None
        cross_validated = [entry for entry in self.standings if math.isfinite(entry.cross_p_value)]
        best_crossed = min(cross_validated, key=lambda entry: geometric_mean(entry.cross_validated))
        loss = geometric_mean(best.cross_validated) / geometric_mean(best_crossed.cross_validated)
        return best_crossed if loss > max(MIN_CONTRADICTION_RATIO, best_crossed.error / best.error) else None

    @cached_property
    def choice(self) -> RankedCombination | None:
        """The recommended combination of those that are as good as the best.

        Its bodies are possible and it converged, where there is any such, and of these it is the fastest. Times
        within a factor of two, or half a second, count as equal: of those it is that of the configuration, or else
        the one with the least error. Where there is a ``rival``, only those count that cross-validation does not
        contradict: there may be none.
        """
        options = list(self.as_good)
        if self.rival is not None:
            max_error = MIN_CONTRADICTION_RATIO * geometric_mean(self.rival.cross_validated)
            options = [entry for entry in options if geometric_mean(entry.cross_validated) <= max_error]
        if not options:
            return None
        # prefer estimates that converged and are physical, as far as there are any
        sound_options = [entry for entry in options if entry.is_physical and entry.outcome is CombinationOutcome.OK]
        options = sound_options or [entry for entry in options if entry.is_physical] or options
        least_seconds = min(entry.seconds for entry in options)
        fast_options = [entry for entry in options if not entry.takes_longer(least_seconds)]
        return next((entry for entry in fast_options if entry.combination.is_configured), fast_options[0])

    @property
    def configured_entry(self) -> RankedCombination | None:
        """The combination of the configuration."""
        return next((entry for entry in self.rows if entry.combination.is_configured), None)

    def numbers(self, entry: RankedCombination) -> dict[str, Any]:
        """Return a combination as plain values: its names, outcome, errors, differences, conditions and times."""
        row: dict[str, Any] = {
            "smoother": entry.combination.smoother, "estimator": entry.combination.estimator,
            "own": entry.combination.is_configured, "status": entry.outcome.value, "reason": entry.reason,
            "notes": list(entry.notes), "error": entry.error, "overall": entry.overall,
            "difference": entry.error - self.best.error if self.best else math.nan, "interval": list(entry.interval),
            "p_value": entry.p_value, "worse": entry.is_worse, "held_out": dict(entry.held_out),
            "same_motion": dict(entry.same_motion), "training": dict(entry.training),
            "cross_validated": dict(entry.cross_validated), "condition": entry.condition,
            "eigenvalue": entry.eigenvalue, "cross_p_value": entry.cross_p_value,
            "seconds": [entry.seconds_smoothing, entry.seconds_estimate, entry.seconds_validation],
        }  # fmt: skip
        if (truth := entry.truth) is not None:
            row["truth"] = {"error": truth.error, "std": truth.std, "median_relative": truth.relative,
                            "over_bound": truth.over_bound, "covered": truth.covered, "count": truth.count}  # fmt: skip
        return row

    def frame(self) -> pl.DataFrame:
        """Return a table of the ``numbers``, one row per combination, null where not known: errors by joint as
        geometric means, those held out also by joint (``held_out.JOINT``), the interval by its ends ``lower`` and
        ``upper``, the seconds of smoothing and estimate, and the notes as one text."""
        import polars as pl

        rows = []
        for entry in self.rows:
            row = self.numbers(entry)
            means = {name: geometric_mean(row[name]) for name in ("same_motion", "cross_validated", "training")}
            lower, upper = entry.interval
            by_joint = {f"held_out.{joint}": entry.held_out.get(joint) for joint in self.joints}
            texts = {"notes": ", ".join(entry.notes), "seconds": entry.seconds, "lower": lower, "upper": upper}
            plain = {name: value for name, value in row.items() if not isinstance(value, dict | list)}
            rows.append(plain | means | texts | by_joint)
        frame = pl.DataFrame(rows, schema_overrides={"eigenvalue": pl.Float64}, infer_schema_length=None)
        return frame.with_columns(pl.selectors.float().fill_nan(None))


def geometric_mean(by_joint: Mapping[str, float]) -> float:
    """Return the geometric mean over joints of the finite values, nan where there are none."""
    finite = np.array([value for value in by_joint.values() if math.isfinite(value)])
    return float(np.exp(np.log(np.maximum(finite, 100.0 * MIN_RELATIVE_ERROR)).mean())) if len(finite) else math.nan
