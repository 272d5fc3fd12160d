"""What estimators by simulation share: the descent from least squares, and the estimate that follows from it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.least_squares import joint_weights, weighted
from dynident.estimators.linear import LinearFit, estimate_of, of_information, solve
from dynident.estimators.output_error.descent import Descent
from dynident.estimators.output_error.shots import Shots

__all__ = ["OutputFit", "fitted"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OutputFit:
    """A fit by simulation: its ``value`` (p), and as ``linear`` rows what of it the data determine."""

    value: Array
    linear: LinearFit

    __repr__ = brief

    def estimate(self, problem: Problem) -> Estimate:
        """Return the estimate, whose undetermined directions are those of the start."""
        found = estimate_of(problem, self.linear)
        return replace(found, value=self.value, residual=self.linear.residual(problem, self.value))


def fitted(problem: Problem, shots: tuple[Shots, ...], iterations: int) -> OutputFit:
    """Return the fit of stretches of recordings, on the directions of the parameters that their motion determines."""
    triangular, parameters = problem.regression.triangular_factors, problem.model.parameters
    weights = joint_weights(triangular, "per_joint", 3, parameters)
    factor, rank = weighted(triangular, weights, parameters)
    r = rank.rank
    turn = rank.determined / rank.values[:r]
    found = Descent(problem, turn, iterations).fit(solve(factor, rank).value, shots)
    back = rank.values[:r, None] * rank.vectors[:, :r].T * rank.scale
    information = back.T @ found.information @ back
    fit = of_information(found.value, information, rank, found.samples, found.notes)
    return OutputFit(found.value, replace(fit, weights=weights, correlated=True))
