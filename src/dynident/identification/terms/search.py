"""Forward selection of the terms of one joint, with all others as they are, by blocks of time and by faster motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.identification.terms.bodies import Normal
from dynident.identification.terms.candidates import Kind
from dynident.identification.terms.choice import Outcome, Trial
from dynident.identification.terms.grams import Fits, Folds, JointGrams, tried
from dynident.models import JointTerm, Term

__all__ = ["LEAST", "Division", "Entered", "Group", "JointSearch", "renumbered", "share"]

Array = NDArray[np.float64]
LEAST = 1.0  # %, of the squared error: what a term must remove
NOTHING, IDLE = 0.5, 2.0  # %: gain of a term of the plain set that is needless, and two standard errors above it
SURE, STRICT = 1.5, 2.0  # standard errors that a gain must exceed: about ten kinds are tried on each joint
STAYS = 0.5  # of the standard errors with which a term enters, that it needs to stay
SIGNED = ("viscous", "coulomb", "rotor")  # roles that are never negative
ALWAYS = ("offset", "rotor")  # what is kept even where it is not seen: without it others are biased
FASTER = 2.0  # standard errors below nothing at which faster motion refutes a kind that is not strict
CLEAR = 5.0  # standard errors of a gain that faster motion must refute twice
TURNS = 5  # at most, in which the sizes of what has entered settle
MOST = 9  # terms of a joint


@dataclass(frozen=True, eq=False)
class Group:
    """A ``kind`` with its sizes: the ``terms`` on one joint, and the columns ``at`` of each."""

    kind: Kind
    terms: tuple[Term, ...]
    at: tuple[tuple[int, ...], ...]

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Entered:
    """A group that has entered, and which ``size`` of it."""

    group: Group
    size: int

    __repr__ = brief

    @property
    def columns(self) -> tuple[int, ...]:
        """Its columns."""
        return self.group.at[self.size]

    @property
    def term(self) -> Term:
        """The term."""
        return self.group.terms[self.size]


@dataclass(frozen=True, eq=False)
class Division:
    """The folds by ``blocks``, the same from slow to fast samples (``faster``) and from inner to outer ones
    (``further``), by recording (``logs``, None for one), and the ``whole`` fitted and judged by itself.

    ``train`` (S, F) are the blocks of the other joints in each of the fits that these need.
    """

    blocks: Folds
    faster: Folds
    further: Folds
    whole: Folds
    logs: Folds | None
    train: Array

    __repr__ = brief

    @classmethod
    def of(cls, logs: NDArray[np.intp]) -> Division:
        """Return the division of blocks by the log (F) of each."""
        F, C = len(logs), 4
        eye, every = np.eye(F), np.arange(F)
        out, all_of = 1.0 - eye, np.ones((1, F))
        slow, inner = np.array([1.0, 1.0, 0.0, 0.0]), np.array([1.0, 0.0, 1.0, 0.0])
        names = np.unique(logs)
        by_log = (logs[None] == names[:, None]).astype(float)
        one = np.ones(C)
        several = len(names) > 1
        return cls(
            Folds(_outer(out, one), _outer(eye, one), every),
            Folds(_outer(out, slow), _outer(eye, 1.0 - slow), every),
            Folds(_outer(out, inner), _outer(eye, 1.0 - inner), every),
            Folds(_outer(all_of, one), _outer(all_of, one), np.array([F])),
            Folds(_outer(1.0 - by_log, one), _outer(by_log, one), F + 1 + np.arange(len(names))) if several else None,
            np.concatenate([out, all_of, *([1.0 - by_log] if several else [])]),
        )


def _outer(blocks: Array, classes: Array) -> Array:
    return blocks[:, :, None] * classes


def share(gains: Array, before: Array) -> tuple[float, float]:
    """Return the sum of gains (T) as a share (%) of the squared errors before, and its standard error."""
    total = float(before.sum())
    if not total > 0:
        return 0.0, 0.0
    spread = float(np.sqrt(len(gains)) * gains.std(ddof=1)) if len(gains) > 1 else 0.0
    return 100.0 * float(gains.sum()) / total, 100.0 * spread / total


@dataclass(frozen=True, eq=False)
class _Found:
    """A trial with the gains (T) in its blocks, and the size that fits all samples best."""

    trial: Trial
    gains: Array
    entered: Entered


@dataclass(eq=False)
class JointSearch:
    """What is tried on one ``joint``: its ``grams``, ``groups`` of columns, the ``division`` of its samples, its
    ``weight``, and what has ``entered`` so far. ``rest`` are the normal matrices from all others."""

    joint: str
    grams: JointGrams
    groups: tuple[Group, ...]
    division: Division
    weight: float
    entered: list[Entered] = field(default_factory=list)
    trials: dict[str, Trial] = field(default_factory=dict)

    __repr__ = brief

    @property
    def columns(self) -> list[int]:
        """The columns that have entered."""
        return [i for one in self.entered for i in one.columns]

    def forward(self, rest: Normal) -> None:
        """Let the best group enter, or a simpler one within a standard error of it, until none is good enough."""
        while len(self.entered) < MOST:
            have = {one.group.kind.name for one in self.entered}
            groups = [one for one in self.groups if one.kind.name not in have]
            found = self._tried(rest, groups)
            known = sorted(found, key=lambda one: (one.trial.outcome is not Outcome.NOT_EXCITED, one.trial.gain))
            self.trials |= {one.trial.kind: one.trial for one in known}  # the best of those of one name
            good = [one for one in self._again(rest, found) if one.trial.outcome is Outcome.ENTERED]
            if not good:
                return
            if not any(one.group.kind.dry for one in self.entered):  # what is left of it has no meaning without
                good = [one for one in good if one.entered.group.kind.dry] or good
            best = max(good, key=lambda one: one.trial.gain)
            chosen = next(one for one in good if one is best or _as_good(one, best))
            self.entered.append(chosen.entered)
            self._resize(rest)

    def _again(self, rest: Normal, found: list[_Found]) -> list[_Found]:
        """Return the same, with a look again at the best where faster motion refutes it and the blocks do not.

        The sizes of what has entered were fitted without it, and may be wrong for that reason alone.
        """
        best = max(found, key=lambda one: one.trial.gain, default=None)
        if best is None or best.trial.outcome is not Outcome.REFUTED_FASTER or best.trial.gain < CLEAR * best.trial.std:
            return found
        tentative = replace(self, entered=[*self.entered, best.entered], trials={})
        tentative._resize(rest)
        *others, one = tentative.entered
        alone = Group(one.group.kind, (one.term,), (one.columns,))
        (seen,) = replace(self, entered=others, trials={})._tried(rest, [alone])
        if seen.trial.outcome is not Outcome.ENTERED:
            return found
        self.trials[seen.trial.kind] = seen.trial
        return [replace(seen, entered=best.entered)]

    def backward(self, rest: Normal) -> None:
        """Take out, one by one, what the others have made needless."""
        while self.entered:
            found = [(one, self._without(rest, one)) for one in self.entered if one.group.kind.name not in ALWAYS]
            worse = [(one, trial) for one, trial in found if trial.outcome is not Outcome.ENTERED]
            if not worse:
                return
            one, trial = min(worse, key=lambda pair: pair[1].gain)
            self.entered.remove(one)
            self.trials[trial.kind] = replace(trial, outcome=Outcome.REDUNDANT)

    def _resize(self, rest: Normal) -> None:
        """Give each two groups that have entered the sizes that are best together, in turn until none changes.

        Two at a time, because the widths of two signs can make up for each other.
        """
        sized = [k for k, one in enumerate(self.entered) if len(one.group.at) > 1]
        for _ in range(TURNS):
            before = [one.size for one in self.entered]
            for own in combinations(sized, min(2, len(sized))) if sized else ():
                columns = [i for k, other in enumerate(self.entered) if k not in own for i in other.columns]
                sizes = list(product(*(range(len(self.entered[k].group.at)) for k in own)))
                at = [sum((self.entered[k].group.at[i] for k, i in zip(own, some, strict=True)), ()) for some in sizes]
                fits = tried(self.grams, self.division.whole, rest, columns, [at], self.weight)
                for k, i in zip(own, sizes[int(fits.best[0, 0])], strict=True):
                    self.entered[k] = replace(self.entered[k], size=i)
            if before == [one.size for one in self.entered]:
                return

    def exchange(self, rest: Normal) -> None:
        """Take, for each group in turn, what would be chosen if it were not there, where that predicts better."""
        for one in list(self.entered):
            if one.group.kind.presumed or one not in self.entered:
                continue
            groups = tuple(group for group in self.groups if group.kind.name != one.group.kind.name)
            other = replace(self, groups=groups, entered=[x for x in self.entered if x is not one], trials={})
            other.forward(rest)
            other.backward(rest)
            if other.errors(rest).sum() < self.errors(rest).sum():
                self.entered = other.entered
                self.trials |= other.trials

    def errors(self, rest: Normal, columns: Sequence[int] | None = None) -> Array:
        """Return the squared errors (F) of the blocks with columns, those that have entered by default."""
        chosen = self.columns if columns is None else columns
        return tried(self.grams, self.division.blocks, rest, chosen, (), self.weight).before

    def _without(self, rest: Normal, one: Entered) -> Trial:
        """Return the trial of a group that has entered, beside all others that have."""
        others = [other for other in self.entered if other is not one]
        alone = Group(one.group.kind, (one.term,), (one.columns,))
        (found,) = replace(self, entered=others, trials={})._tried(rest, [alone], stays=True)
        if _presumed(one.group.kind, others) and found.trial.outcome is not Outcome.NEGATIVE:
            idle = found.trial.gain < NOTHING and found.trial.gain + 2.0 * found.trial.std < IDLE
            return replace(found.trial, outcome=Outcome.TOO_SMALL if idle else Outcome.ENTERED)
        return found.trial

    def _tried(self, rest: Normal, groups: Sequence[Group], *, stays: bool = False) -> list[_Found]:
        """Return the trials of groups; what has entered before ``stays`` with a less sure gain."""
        if not groups:
            return []
        at = [one.at for one in groups]
        blocks, whole = (
            tried(self.grams, folds, rest, self.columns, at, self.weight)
            for folds in (self.division.blocks, self.division.whole)
        )
        found = []
        for g, group in enumerate(groups):
            size, gains = int(whole.best[0, g]), blocks.before - blocks.after[:, g]
            gain, std = share(gains, blocks.before)
            outcome = self._outcome(group, size, gain, (STAYS if stays else 1.0) * std, whole, g)
            trial = Trial(self.joint, group.kind.name, _settings(group.terms[size]), gain, std, outcome)
            found.append(_Found(trial, gains, Entered(group, size)))
        return found if stays else self._beyond(rest, found)

    def _outcome(self, group: Group, size: int, gain: float, std: float, whole: Fits, g: int) -> Outcome:
        if not whole.seen[0, g]:
            return Outcome.NOT_EXCITED
        roles = [one.role for one in group.terms[size].parameters]
        if any(role in SIGNED and x < 0 for role, x in zip(roles, whole.values[g][0], strict=True)):
            return Outcome.NEGATIVE
        if _presumed(group.kind, self.entered):
            return Outcome.ENTERED if gain > 0 or gain + std > LEAST else Outcome.TOO_SMALL
        if gain < LEAST:
            return Outcome.TOO_SMALL
        return Outcome.ENTERED if gain > std * (STRICT if group.kind.strict else SURE) else Outcome.WITHIN_ERROR

    def _beyond(self, rest: Normal, found: list[_Found]) -> list[_Found]:
        """Return the same, with what does not hold on faster motion, further out or in another recording refuted."""
        good = [k for k, one in enumerate(found) if one.trial.outcome is Outcome.ENTERED]
        if not good:
            return found
        at = [found[k].entered.group.at for k in good]
        division = self.division
        beyond = [division.faster, division.further, *([] if division.logs is None else [division.logs])]
        fits = [tried(self.grams, folds, rest, self.columns, at, self.weight) for folds in beyond]
        for g, k in enumerate(good):
            kind, outcome = found[k].entered.group.kind, Outcome.ENTERED
            faster, *elsewhere = (share(one.before - one.after[:, g], one.before) for one in fits)
            if not _presumed(kind, self.entered):
                outcome = _held(kind, faster, elsewhere)
            trial = replace(found[k].trial, outcome=outcome, faster=faster[0], faster_std=faster[1])
            found[k] = replace(found[k], trial=trial)
        return found


def _held(kind: Kind, faster: tuple[float, float], elsewhere: Sequence[tuple[float, float]]) -> Outcome:
    """Return whether a kind holds on faster motion, further out, and in other recordings, by its gains there."""
    further, *logs = elsewhere
    if faster[0] < -(FASTER if not kind.strict else 1.0) * faster[1]:
        return Outcome.REFUTED_FASTER
    if kind.reaches and further[0] < max(LEAST, further[1]):
        return Outcome.REFUTED_FURTHER
    return Outcome.REFUTED_BY_LOG if any(gain < 0 for gain, _ in logs) else Outcome.ENTERED


def _presumed(kind: Kind, others: Sequence[Entered]) -> bool:
    """Whether a kind belongs to the plain set, and no other dry friction takes its place."""
    return kind.presumed and not (kind.dry and any(one.group.kind.dry for one in others))


def _as_good(one: _Found, best: _Found) -> bool:
    """Whether a trial is within a standard error of the best, block by block."""
    less = best.gains - one.gains
    return bool(less.sum() <= np.sqrt(len(less)) * less.std(ddof=1))


def _settings(term: Term) -> tuple[tuple[str, object], ...]:
    """Return the constants of a term by name."""
    if isinstance(term, JointTerm):
        return tuple((name, term.constant(name, term.acts_on[0])) for name in term.constants)
    return tuple(getattr(term, "settings", ()))


def renumbered(entered: Sequence[Entered]) -> list[Entered]:
    """Return what has entered with its columns one after the other."""
    found, first = [], 0
    for one in entered:
        at = tuple(range(first, first + len(one.columns)))
        found.append(Entered(Group(one.group.kind, (one.term,), (at,)), 0))
        first += len(at)
    return found
