"""DIDIM: the torque of the simulated closed loop is fitted to the measured one, with the inverse dynamics as its slope."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from dynident.errors import InputError, Note, Step, changed
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.instrumental_variables.instruments import Instruments, paired
from dynident.estimators.instrumental_variables.moments import Moments, information_of, moments_of
from dynident.estimators.instrumental_variables.simulated import controller_of, simulated_instruments
from dynident.estimators.least_squares import MOST, LeastSquares, Weights, check_weights, joint_weights, weighted
from dynident.estimators.linear import LinearFit, estimate_of, of_information, solve
from dynident.estimators.output_error.first import first_runs, no_controller
from dynident.estimators.output_error.notes import StartedElsewhere, StillSimulating
from dynident.regression import Rank, Regression
from dynident.simulation import Failure

__all__ = ["Didim"]

Array = NDArray[np.float64]
SETTLED = 0.01  # standard errors
ROUNDING = 1e-10  # relative change of the torque
SHORTEST = 2**-6  # share of a step that is still tried where the loop fails after it


@dataclass(frozen=True)
class Didim:
    """Least squares of the measured torque on the regressor of the simulated motion, repeated until theta stays.

    The model in the loop of the recorded controller (``Log.controller``), under the recorded reference, moves and asks
    for a torque tau_s(theta) = Y(q_s, dq_s, ddq_s) theta; minimised is its difference to the measured torque. A good
    loop moves alike with any model, so that Y is about the derivative of tau_s: each step is linear least squares. No
    noise of the positions is in Y, and none is differentiated. It begins with least squares, or, where this fails in the
    loop, with the physically consistent fit. A step after which the loop fails is halved. ``weights`` are those of the
    joints, by their residuals; ``iterations`` is the most of them.

    The covariance allows for residuals that are correlated in time and between joints. Disturbances that the loop feeds
    back are in the residual. Raises MissingInputError where a recording does not know its controller, InputError where
    the first model fails in the loop, ConfigError for bad settings. Reference: Gautier, Janot and Vandanjon (2013).
    """

    weights: Weights = "per_joint"
    iterations: Annotated[int, Ge(1), Le(MOST)] = 20

    __repr__ = changed

    def __post_init__(self) -> None:
        check_weights(self.weights, self.iterations)

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; a note says where the iteration did not settle."""
        return estimate_of(problem, self.reduced(problem))

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the value with its information, as rows that constraints can be put on."""
        for k, motion in enumerate(problem.motions):
            if controller_of(problem, k) is None:
                raise no_controller(motion)
        triangular, parameters = problem.regression.triangular_factors, problem.model.parameters
        weights = joint_weights(triangular, self.weights, 3, parameters)
        factor, rank = weighted(triangular, weights, parameters)
        found = _Run(problem, self, weights, rank).fit(solve(factor, rank).value)
        return replace(found, weights=None) if self.weights == "equal" else found

    def quick(self) -> LeastSquares:
        """Return least squares: a search needs no simulation."""
        return LeastSquares(weights=self.weights)


@dataclass(eq=False)
class _Run:
    """One estimation in progress."""

    problem: Problem
    settings: Didim
    weights: Array
    rank: Rank
    notes: list[Note] = field(default_factory=list)

    def fit(self, start: Array) -> LinearFit:
        """Return the fit that begins with the ``start`` (p) of least squares."""
        self.problem.progress("simulating the closed loop")
        value, runs, other = first_runs(self.problem, start, self.simulated)
        if other is not None:
            self.notes.append(StartedElsewhere(other))
        for iteration in range(1, self.settings.iterations + 1):
            rows, found = self.solved(runs)
            moved, change = found.distance(found.value, value), found.change(found.value, value)
            if moved < SETTLED or change < ROUNDING:
                value = found.value
                break
            self.problem.progress(Step("simulating the closed loop", iteration, self.settings.iterations))
            value, runs, share = self.stepped(value, found.value)
            if iteration == self.settings.iterations or share < 1:
                self._unsettled(iteration, moved, share)
            if share < SHORTEST:
                break
        rows, found = self.solved(runs)
        information, _ = information_of(found, rows, rows, self.rank, found.value)
        fit = of_information(found.value, information, self.rank, int(found.rows.sum()), tuple(self.notes))
        return replace(fit, weights=self.weights)

    def _unsettled(self, iteration: int, moved: float, share: float) -> None:
        """Note that the last iteration, or one whose step had to be cut, has not settled."""
        self.notes[:] = [one for one in self.notes if not isinstance(one, StillSimulating)]
        if iteration == self.settings.iterations or share < SHORTEST:
            self.notes.append(StillSimulating(iteration, moved))

    def simulated(self, theta: Array) -> list[Instruments] | Failure:
        """Return the simulated motions of all recordings, or the first failure."""
        found = []
        for k in range(len(self.problem.motions)):
            one = simulated_instruments(self.problem, k, theta)
            if isinstance(one, Failure):
                return one
            found.append(one)
        return found

    def stepped(self, value: Array, to: Array) -> tuple[Array, list[Instruments], float]:
        """Return the value after the longest step towards ``to`` with which the loop works, its runs, and the share."""
        share = 1.0
        while share >= SHORTEST:
            there = value + share * (to - value)
            runs = self.simulated(there)
            if not isinstance(runs, Failure):
                return there, runs, share
            share /= 2
        runs = self.simulated(value)
        if isinstance(runs, Failure):  # it has worked before
            raise InputError("the closed loop cannot be simulated again.")
        return value, runs, 0.0

    def solved(self, runs: Sequence[Instruments]) -> tuple[Regression, Moments]:
        """Return the rows of the simulated motion with the measured torque, and their moments with new weights."""
        _, rows = paired(self.problem, runs)
        found = moments_of(rows, rows, self.rank, self.weights)
        if self.settings.weights == "per_joint":
            size = np.sqrt(found.residual(found.to_turn(found.value)))
            self.weights = 1.0 / np.maximum(size, 1e-7 * np.sqrt(found.square / np.maximum(found.rows, 1)))
            found = replace(found, weights=self.weights)
        return rows, found
