"""One estimation by instrumental variables: the choice of the instruments, and the iteration of simulated ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, Step
from dynident.estimators.estimator import Problem
from dynident.estimators.first_model import other_model
from dynident.estimators.instrumental_variables.instruments import Instruments, paired
from dynident.estimators.instrumental_variables.lagged import lagged_instruments
from dynident.estimators.instrumental_variables.moments import Moments, moments_of
from dynident.estimators.instrumental_variables.notes import (
    InstrumentKind,
    InstrumentsUsed,
    MotionMovesOn,
    NotSimulated,
    WeakInstruments,
)
from dynident.estimators.instrumental_variables.repeated import not_repeated, repeated_instruments
from dynident.estimators.instrumental_variables.scores import information_of
from dynident.estimators.instrumental_variables.simulated import (
    failed,
    missing,
    simulated_instruments,
)
from dynident.estimators.linear import LinearFit, of_information
from dynident.estimators.loops import controller_of, log_of, reason_of
from dynident.estimators.notes import StartedElsewhere
from dynident.log import Motion
from dynident.regression import Rank, Regression
from dynident.simulation import Failure

__all__ = ["Run", "Source"]

Array = NDArray[np.float64]
Source = Literal["auto", "simulated", "repeated", "lagged"]
COVERED, ALIKE = 0.5, 0.3  # share of the samples that another pass must have, unless it is asked for; of the speed
SETTLED = 0.01  # standard errors
ROUNDING = 1e-10  # relative change of the torque
WEAK = 10.0  # F of the first stage below which instruments are weak (Staiger and Stock, 1997)


@dataclass(eq=False)
class Run:
    """One estimation in progress, from the settings, the weights of the joints, and the rank of the weighted rows.

    ``value`` (p) is the last one, at first the ``start`` of least squares.
    """

    problem: Problem
    source: Source
    iterations: int
    lag: float | None
    weights: Array
    rank: Rank
    start: Array
    notes: list[Note] = field(default_factory=list)

    def fit(self) -> LinearFit:
        """Return the fit; simulated instruments are those of the last value but one, which is about the last."""
        value, moved = self.start, np.inf
        instruments = self.first([self.given(k) for k in range(len(self.problem.motions))])
        loops = [k for k, one in enumerate(instruments) if one.kind is InstrumentKind.SIMULATED]
        for iteration in range(1, self.iterations + 1):
            rows, others, found = self.solved(instruments)
            moved, changed = found.distance(found.value, value), found.change(found.value, value)
            value = found.value
            if not loops or moved < SETTLED or changed < ROUNDING:
                break
            if iteration == self.iterations:
                self.notes.append(MotionMovesOn(iteration, moved))
                break
            self.problem.progress(Step("simulating instruments", iteration, self.iterations))
            again = self.simulated(value, loops)
            if isinstance(again, Failure):
                self.notes.append(MotionMovesOn(iteration, moved, reason_of(again)))
                break
            instruments = [again.get(k, one) for k, one in enumerate(instruments)]
        return self.finished(instruments, (rows, others), found)

    def given(self, k: int) -> Instruments | None:
        """Return the instruments of the k-th recording, None where they are to be simulated."""
        problem, motion = self.problem, self.problem.motions[k]
        if self.source in ("auto", "simulated") and controller_of(problem, k) is not None:
            return None
        if self.source == "simulated":
            raise missing(motion)
        return self.measured(k)

    def measured(self, k: int) -> Instruments:
        """Return the instruments of the k-th recording that are made of measurements."""
        problem, motion = self.problem, self.problem.motions[k]
        found = None if self.source == "lagged" else repeated_instruments(problem, k)
        if found is not None and (self.source == "repeated" or _repeats(found, motion)):
            return found
        if self.source == "repeated":
            raise not_repeated(motion)
        return lagged_instruments(problem.model, motion, log_of(problem, k), problem.regression.filter, self.lag)

    def first(self, given: Sequence[Instruments | None]) -> list[Instruments]:
        """Return the first instruments of all recordings: where the model of least squares fails in a loop, those of
        another one; where all fail, measured ones, or InputError if they must be simulated."""
        loops = [k for k, one in enumerate(given) if one is None]
        found: dict[int, Instruments] | Failure = {}
        if loops:
            self.problem.progress("simulating instruments")
            found = self.simulated(self.start, loops)
        if isinstance(found, Failure):
            found = self.rescued(found, loops)
        return [found[k] if one is None else one for k, one in enumerate(given)]

    def rescued(self, failure: Failure, loops: Sequence[int]) -> dict[int, Instruments]:
        """Return the instruments of these recordings where those of least squares cannot be simulated."""
        other = other_model(self.problem, failure, lambda value: self.simulated(value, loops))
        if not isinstance(other, Failure):
            _, found, kind = other
            self.notes.append(StartedElsewhere(kind))
            return found
        if self.source == "simulated":
            raise failed(self.problem.motions[loops[0]], other)
        self.notes.append(NotSimulated(reason_of(other)))
        return {k: self.measured(k) for k in loops}

    def simulated(self, theta: Array, loops: Sequence[int]) -> dict[int, Instruments] | Failure:
        """Return the simulated instruments of these recordings, or the first failure."""
        found = {}
        for k in loops:
            one = simulated_instruments(self.problem, k, theta)
            if isinstance(one, Failure):
                return one
            found[k] = one
        return found

    def solved(self, instruments: Sequence[Instruments]) -> tuple[Regression, Regression, Moments]:
        """Return the rows, those of the instruments, and their moments."""
        rows, others = paired(self.problem, instruments)
        return rows, others, moments_of(rows, others, self.rank, self.weights)

    def finished(
        self, instruments: Sequence[Instruments], both: tuple[Regression, Regression], found: Moments
    ) -> LinearFit:
        """Return the fit with its information and notes."""
        information, independent = information_of(found, *both, instruments, self.rank)
        fit = of_information(found.value, information, self.rank, int(found.rows.sum()), ())
        weakest, names = found.strength(independent), self.problem.model.names
        if weakest.statistic < WEAK:
            most = int(np.argmax(np.abs(weakest.direction * self.rank.scale)))
            self.notes.append(WeakInstruments(names[most], weakest.correlation, weakest.statistic))
        if self.problem.logs:  # else the motions are taken as measured
            std = np.sqrt(np.diag(fit.directions.covariance()))
            moved = np.abs(found.value - self.start) / std
            lags = [one.lag for one in instruments if one.lag is not None]
            kinds = tuple(dict.fromkeys(one.kind for one in instruments))
            k = int(np.argmax(moved))
            name = names[k] if np.isfinite(std[k]) else None
            used = InstrumentsUsed(kinds, weakest.correlation, max(lags, default=None), name, float(moved[k]))
            self.notes.insert(0, used)
        return replace(fit, weights=self.weights, notes=tuple(self.notes), correlated=True)


def _repeats(one: Instruments, motion: Motion) -> bool:
    """Whether another pass has most samples of a motion, and each joint about the same speeds there."""
    both = one.motion.mask & motion.mask
    size, apart = (np.linalg.norm(x[both], axis=0) for x in (motion.dq, motion.dq - one.motion.dq))
    return bool(both.sum() > COVERED * motion.mask.sum() and (apart <= ALIKE * size).all())
