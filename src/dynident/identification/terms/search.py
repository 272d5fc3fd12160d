"""Stepwise selection of the terms of one joint beside all others, by blocks of time and by faster motion."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np

from dynident.identification.terms.candidates import CandidateKind, TermGroup, TermTrial, TrialOutcome, settings_of
from dynident.identification.terms.grams import (
    CandidateGrams,
    Folds,
    JointGrams,
    Normal,
    SearchFolds,
    TrialFits,
    gain_share,
    normal_matrices,
    transfer_gains,
    try_groups,
)
from dynident.models import Term
from dynident.models.friction import DryFriction
from dynident.runtime import Noun, brief
from dynident.runtime.arrays import Array

Share = tuple[float, float]  # %, of a gain in the squared error, and its standard error
MIN_GAIN = 1.0  # %, of the squared error: what a term must remove
# %: gain of a term of the plain set that is needless, and two standard errors above it
NEGLIGIBLE_GAIN, MAX_IDLE_GAIN = 0.5, 2.0
# standard errors that a gain must exceed: about ten kinds are tried on each joint
MIN_GAIN_ERRORS, MIN_STRICT_GAIN_ERRORS = 1.5, 2.0
MIN_POOL, MAX_POOL = 0.3, 1.2  # of these: for a kind that all other joints have, and one that none has
STAY_FACTOR = 0.5  # of the standard errors with which a term enters, that it needs to stay
NONNEGATIVE_ROLES = ("viscous", "coulomb", "rotor")  # roles that are never negative
PERMANENT_KINDS = ("offset", "rotor")  # what is kept even where it is not seen: without it others are biased
MAX_FASTER_LOSS = 2.0  # standard errors below nothing at which faster motion refutes a kind that is not strict
CLEAR_GAIN_ERRORS = 5.0  # standard errors of a gain that faster motion must refute twice
MAX_SHARP_LOSS = 1.15  # factor of the squared error by which a sharp sign may be worse than a narrow one
MAX_RESIZE_TURNS = 5  # at most, in which the sizes of what has entered settle
MAX_TERMS = 9  # terms of a joint


class TermEntry(Noun):
    """A group that has entered the fit, in a ``size``."""

    group: TermGroup
    size: int

    @property
    def columns(self) -> tuple[int, ...]:
        """Its columns."""
        return self.group.at[self.size]

    @property
    def term(self) -> Term:
        """The term."""
        return self.group.terms[self.size]


@dataclass(frozen=True, eq=False)
class _TrialResult:
    """The trial of a group with its gains (T) in the blocks, and the entry with the size that fits all samples best."""

    trial: TermTrial
    gains: Array
    entered: TermEntry


@dataclass(eq=False)
class JointSearch:
    """The search on one ``joint``: its ``grams``, ``groups``, ``division`` of samples and ``weight``.

    ``shares`` is on what share of the other joints a kind has entered before: joints of an arm have like friction.
    ``entered`` is what has entered so far. Methods take the ``candidates`` beside all other joints.
    """

    joint: str
    grams: JointGrams
    groups: tuple[TermGroup, ...]
    division: SearchFolds
    weight: float
    shares: Mapping[str, float] = field(default_factory=dict)
    entered: list[TermEntry] = field(default_factory=list)
    trials: dict[str, TermTrial] = field(default_factory=dict)

    __repr__ = brief

    @property
    def columns(self) -> list[int]:
        """The columns that have entered."""
        return [i for entry in self.entered for i in entry.columns]

    @property
    def normal(self) -> Normal:
        """The normal matrices of the model's parameters from the equations of this joint."""
        return normal_matrices(self.grams.only(self.columns), self.division.train, self.weight)

    @property
    def without_candidates(self) -> JointSearch:
        """The search with the columns that have entered alone, whose matrices are small."""
        return replace(self, grams=self.grams.only(self.columns), entered=renumber_columns(self.entered))

    def beside(self, other_normals: Normal) -> CandidateGrams:
        """Return the candidates beside the normal matrices of all other joints."""
        return CandidateGrams(self.grams, other_normals, self.weight)

    def entries(self, names: Collection[str]) -> list[TermEntry]:
        """Return the groups of the kinds with these names, each in its first size."""
        return [TermEntry(group, 0) for group in self.groups if group.kind.name in names]

    def forward(self, candidates: CandidateGrams) -> None:
        """Add the best group, or a simpler one within a standard error of it, until none is good enough."""
        while len(self.entered) < MAX_TERMS:
            entered_names = {entry.group.kind.name for entry in self.entered}
            results = self._try_groups(candidates, [x for x in self.groups if x.kind.name not in entered_names])
            ranked = sorted(results, key=lambda x: (x.trial.outcome is not TrialOutcome.NOT_EXCITED, x.trial.gain))
            # the best of those of one name
            self.trials |= {result.trial.kind: result.trial for result in ranked}
            retried = self._retry_best(candidates, results)
            good = [result for result in retried if result.trial.outcome is TrialOutcome.ENTERED]
            if not good:
                return
            # Without dry friction the residual is mostly its sign, which other kinds would imitate.
            if not any(candidate.group.kind.dry for candidate in self.entered):
                good = [candidate for candidate in good if candidate.entered.group.kind.dry] or good
            best = max(good, key=lambda candidate: candidate.trial.gain)
            # A law like the best that gains more is the better guess, though its gain is less even in time.
            good = [candidate for candidate in results if candidate in good or _is_better_kin(candidate, best)] or good
            # Groups are ordered from the simplest on: take the first that is as good as the best.
            simplest = next(candidate for candidate in good if candidate is best or _is_as_good(candidate, best))
            self.entered.append(simplest.entered)
            # The new term changes which widths of the others are best.
            self._resize(candidates)

    def _retry_best(self, candidates: CandidateGrams, results: list[_TrialResult]) -> list[_TrialResult]:
        """Return the results, after a second look at the best that may be, where only faster motion refutes it.

        The sizes of the entered groups were fitted without it, and may be wrong for that reason alone.
        """
        possible = [candidate for candidate in results if candidate.trial.outcome is not TrialOutcome.NEGATIVE]
        best = max(possible, key=lambda candidate: candidate.trial.gain, default=None)
        if best is None or best.trial.outcome is not TrialOutcome.REFUTED_FASTER:
            return results
        if best.trial.gain < CLEAR_GAIN_ERRORS * best.trial.std:
            return results
        # Enter it tentatively, let the sizes settle, and judge it once more beside these.
        tentative = replace(self, entered=[*self.entered, best.entered], trials={})
        tentative._resize(candidates)
        *other_entries, candidate = tentative.entered
        alone = TermGroup(candidate.group.kind, (candidate.term,), (candidate.columns,))
        (retry,) = replace(self, entered=other_entries, trials={})._try_groups(candidates, [alone])
        if retry.trial.outcome is not TrialOutcome.ENTERED:
            return results
        self.trials[retry.trial.kind] = retry.trial
        return [replace(retry, entered=best.entered)]

    def backward(self, candidates: CandidateGrams) -> None:
        """Remove, one by one, the terms that others have made needless."""
        while self.entered:
            removable = (entry for entry in self.entered if entry.group.kind.name not in PERMANENT_KINDS)
            trials = [(entry, self._without(candidates, entry)) for entry in removable]
            worse = [(entry, trial) for entry, trial in trials if trial.outcome is not TrialOutcome.ENTERED]
            if not worse:
                return
            entry, trial = min(worse, key=lambda pair: pair[1].gain)
            self.entered.remove(entry)
            self.trials[trial.kind] = replace(trial, outcome=TrialOutcome.REDUNDANT)

    def _resize(self, candidates: CandidateGrams) -> None:
        """Set the sizes of each two entered groups to those that are best together, in turn until none changes.

        Two at a time, because the widths of two signs can make up for each other.
        """
        sized = [k for k, entry in enumerate(self.entered) if len(entry.group.at) > 1]
        for _ in range(MAX_RESIZE_TURNS):
            before = [entry.size for entry in self.entered]
            for pair in combinations(sized, min(2, len(sized))) if sized else ():
                columns = [i for k, entry in enumerate(self.entered) if k not in pair for i in entry.columns]
                sizes = list(product(*(range(len(self.entered[k].group.at)) for k in pair)))
                # One group of all combinations of sizes: a single pass over the Gram matrices compares them.
                at = [
                    sum((self.entered[k].group.at[i] for k, i in zip(pair, chosen_sizes, strict=True)), ())
                    for chosen_sizes in sizes
                ]
                fits = try_groups(candidates, self.division.all_samples, columns, [at])
                for k, i in zip(pair, sizes[int(fits.best[0, 0])], strict=True):
                    self.entered[k] = replace(self.entered[k], size=i)
            if before == [entry.size for entry in self.entered]:
                return

    def exchange(self, candidates: CandidateGrams) -> None:
        """Replace each group in turn by what would be chosen without it, where that predicts better.

        Groups that were removed though they gain have spoilt signs: without one of them others may enter again.
        """
        removed = [trial for trial in self.trials.values() if trial.outcome is TrialOutcome.REDUNDANT]
        spoilers = [trial.kind for trial in removed if trial.gain > CLEAR_GAIN_ERRORS * trial.std]
        for name in [*spoilers, *(x.group.kind.name for x in self.entered if not x.group.kind.presumed)]:
            others = [x for x in self.entered if x.group.kind.name != name]
            if len(others) == len(self.entered) and name not in spoilers:
                continue  # it was replaced with another
            groups = tuple(group for group in self.groups if group.kind.name != name)
            alternative = replace(self, groups=groups, entered=others, trials={})
            alternative.forward(candidates)
            alternative.backward(candidates)
            if alternative.errors(candidates).sum() < self.errors(candidates).sum():
                self.entered = alternative.entered
                self.trials |= alternative.trials

    def sharpen(self, candidates: CandidateGrams, turning_step: float) -> float:
        """Make signs sharp whose width is at most the ``turning_step``, by which the velocity changes in a sample.

        A sample on the way may hold the torque of both directions, which such a width imitates. Return the speed below
        which that holds, 0 where no sign was changed.
        """
        uncertain_speed = 0.0
        for k, entry in enumerate(self.entered):
            term = entry.term
            if not isinstance(term, DryFriction) or (sharp := replace(term, width=0.0)) not in entry.group.terms:
                continue
            if 0.0 < float(term.constant("width", self.joint)) <= turning_step:
                smooth_error = self.errors(candidates).sum()
                self.entered[k] = replace(entry, size=entry.group.terms.index(sharp))
                # what costs more than a few samples on the way is no mean of theirs
                if self.errors(candidates).sum() > MAX_SHARP_LOSS * smooth_error:
                    self.entered[k] = entry
                    continue
                uncertain_speed = 0.5 * turning_step
                if trial := self.trials.get(entry.group.kind.name):
                    self.trials[trial.kind] = replace(trial, settings=settings_of(sharp))
        return uncertain_speed

    def keep_dry_friction(self, candidates: CandidateGrams) -> None:
        """Keep Coulomb friction in its first size where no dry friction has entered."""
        # One way, Coulomb friction and offset are one column: without the first, all of it would be the offset.
        if not any(entry.group.kind.dry for entry in self.entered):
            for entry in self.entries(("coulomb",)):
                self.trials["coulomb"] = replace(self._without(candidates, entry), outcome=TrialOutcome.KEPT)
                self.entered.append(entry)

    def errors(self, candidates: CandidateGrams) -> Array:
        """Return the squared errors (F) of the blocks with the columns that have entered."""
        return try_groups(candidates, self.division.blocks, self.columns, ()).before

    def _without(self, candidates: CandidateGrams, entry: TermEntry) -> TermTrial:
        """Return the trial of an entered group beside all others."""
        other_entries = [other_entry for other_entry in self.entered if other_entry is not entry]
        alone = TermGroup(entry.group.kind, (entry.term,), (entry.columns,))
        (result,) = replace(self, entered=other_entries, trials={})._try_groups(candidates, [alone], stays=True)
        if _is_presumed(entry.group.kind, other_entries) and result.trial.outcome is not TrialOutcome.NEGATIVE:
            is_idle = result.trial.gain < NEGLIGIBLE_GAIN and result.trial.gain + 2.0 * result.trial.std < MAX_IDLE_GAIN
            return replace(result.trial, outcome=TrialOutcome.TOO_SMALL if is_idle else TrialOutcome.ENTERED)
        return result.trial

    def _try_groups(
        self, candidates: CandidateGrams, groups: Sequence[TermGroup], *, stays: bool = False
    ) -> list[_TrialResult]:
        """Return the trials of groups; those that ``stays`` tells to have entered before need a less certain gain."""
        if not groups:
            return []
        at = [candidate.at for candidate in groups]
        blocks, overall = (
            try_groups(candidates, folds, self.columns, at)
            for folds in (self.division.blocks, self.division.all_samples)
        )
        results = []
        for g, group in enumerate(groups):
            size, gains = int(overall.best[0, g]), blocks.before - blocks.after[:, g]
            gain, std = gain_share(gains, blocks.before)
            outcome = self._outcome(group, size, gain, (STAY_FACTOR if stays else 1.0) * std, overall, g)
            trial = TermTrial(self.joint, group.kind.name, settings_of(group.terms[size]), gain, std, outcome)
            results.append(_TrialResult(trial, gains, TermEntry(group, size)))
        return results if stays else self._refute_elsewhere(candidates, results)

    def _outcome(
        self, group: TermGroup, size: int, gain: float, std: float, overall: TrialFits, g: int
    ) -> TrialOutcome:
        if not overall.independent[0, g]:
            return TrialOutcome.NOT_EXCITED
        roles = [parameter.role for parameter in group.terms[size].parameters]
        # A negative friction coefficient is the sign of another missing effect, whatever it gains.
        if any(role in NONNEGATIVE_ROLES and x < 0 for role, x in zip(roles, overall.values[g][0], strict=True)):
            return TrialOutcome.NEGATIVE
        if _is_presumed(group.kind, self.entered):
            return TrialOutcome.ENTERED if gain > 0 or gain + std > MIN_GAIN else TrialOutcome.TOO_SMALL
        if gain < MIN_GAIN:
            return TrialOutcome.TOO_SMALL
        return TrialOutcome.ENTERED if gain > std * self._min_gain_errors(group.kind) else TrialOutcome.WITHIN_ERROR

    def _min_gain_errors(self, kind: CandidateKind) -> float:
        """Return the standard errors that a gain must exceed: fewer where most other joints have the kind."""
        errors = MIN_STRICT_GAIN_ERRORS if kind.strict else MIN_GAIN_ERRORS
        if kind.name in self.shares:
            errors *= MAX_POOL - (MAX_POOL - MIN_POOL) * self.shares[kind.name]
        return errors

    def _refute_elsewhere(self, candidates: CandidateGrams, results: list[_TrialResult]) -> list[_TrialResult]:
        """Return the results, with those refuted that fail on faster motion, further out or in another recording."""
        good = [k for k, result in enumerate(results) if result.trial.outcome is TrialOutcome.ENTERED]
        if not good:
            return results
        groups, logs = {k: results[k].entered.group for k in good}, self.division.logs
        faster = self._transfer(candidates, self.division.faster, groups)
        # only where it decides: it takes as long as all else
        reaching = {k: group for k, group in groups.items() if group.kind.reaches}
        further = self._transfer(candidates, self.division.further, reaching)
        by_log = None if logs is None else try_groups(candidates, logs, self.columns, [x.at for x in groups.values()])
        for g, (k, group) in enumerate(groups.items()):
            (gain, std), outcome = faster[k][0], TrialOutcome.ENTERED
            if not _is_presumed(group.kind, self.entered):
                is_worse = by_log is not None and by_log.after[:, g].sum() > by_log.before.sum()
                outcome = _outcome_elsewhere(group.kind, (gain, std), further.get(k, ()), is_worse)
            trial = replace(results[k].trial, outcome=outcome, faster=gain, faster_std=std)
            results[k] = replace(results[k], trial=trial)
        return results

    def _transfer(
        self, candidates: CandidateGrams, part: Folds, groups: Mapping[int, TermGroup]
    ) -> dict[int, tuple[Share, Share]]:
        """Return the gains of each group on the test rows of a part: with its coefficients from the training rows, all
        others from both, as those of bodies may be far off; and with all from the training rows."""
        if not groups:
            return {}
        fits, shares = try_groups(candidates, part, self.columns, [x.at for x in groups.values()]), {}
        for g, (k, group) in enumerate(groups.items()):
            columns = fits.group(g, group.at)
            alone = transfer_gains(candidates, self.division.blocks, part.test, self.columns, columns)
            shares[k] = gain_share(*alone), gain_share(fits.before - fits.after[:, g], fits.before)
        return shares


def _outcome_elsewhere(kind: CandidateKind, faster: Share, further: Sequence[Share], is_worse: bool) -> TrialOutcome:
    """Return whether a kind holds on faster motion and further out, by its gains there, and in other recordings.

    Further out a gain by one of two fits suffices.
    """
    # Loss beyond its standard errors refutes, strict kinds already at one of them; so does a lack of fast samples.
    if faster == (0.0, 0.0) or faster[0] < -(MAX_FASTER_LOSS if not kind.strict else 1.0) * faster[1]:
        return TrialOutcome.REFUTED_FASTER
    if kind.reaches and all(gain < max(MIN_GAIN, std) for gain, std in further):
        return TrialOutcome.REFUTED_FURTHER
    return TrialOutcome.REFUTED_BY_LOG if is_worse else TrialOutcome.ENTERED


def _is_presumed(kind: CandidateKind, entries: Sequence[TermEntry]) -> bool:
    """Return whether a kind belongs to the plain set, and no other dry friction takes its place."""
    return kind.presumed and not (kind.dry and any(entry.group.kind.dry for entry in entries))


def _is_as_good(result: _TrialResult, best: _TrialResult) -> bool:
    """Return whether a trial is within a standard error of the best, block by block."""
    shortfall = best.gains - result.gains
    return bool(shortfall.sum() <= np.sqrt(len(shortfall)) * shortfall.std(ddof=1))


def _is_better_kin(result: _TrialResult, best: _TrialResult) -> bool:
    """Return whether a trial gains more than the best, within its error, and both are dry friction of one cause."""
    kinds = result.entered.group.kind, best.entered.group.kind
    alike = all(kind.dry for kind in kinds) and kinds[0].needs_load == kinds[1].needs_load
    return alike and result.trial.outcome is TrialOutcome.WITHIN_ERROR and result.trial.gain >= best.trial.gain


def renumber_columns(entered: Sequence[TermEntry]) -> list[TermEntry]:
    """Return the entries with their columns numbered consecutively."""
    renumbered_entries, start = [], 0
    for entry in entered:
        at = tuple(range(start, start + len(entry.columns)))
        renumbered_entries.append(TermEntry(TermGroup(entry.group.kind, (entry.term,), (at,)), 0))
        start += len(at)
    return renumbered_entries
