"""What estimators by simulation share: the descent from least squares, and the estimate that follows from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import MEMORY, InputError, amount, brief, memory
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.least_squares import joint_weights, weighted
from dynident.estimators.linear import LinearFit, estimate_of, of_information, solve
from dynident.estimators.output_error.descent import Descent
from dynident.estimators.output_error.shots import Shots

__all__ = ["OutputFit", "fitted"]

Array = NDArray[np.float64]
WEIGHT = 20  # bytes for each sample, joint and direction: the derivatives, what the starts leave of them, and more


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
    """Return the fit of stretches of recordings, on the directions of the parameters that their motion determines.

    Raises InputError where the derivatives need more memory than there is.
    """
    triangular, parameters = problem.regression.triangular_factors, problem.model.parameters
    weights = joint_weights(triangular, "per_joint", 3, parameters)
    factor, rank = weighted(triangular, weights, parameters)
    r = rank.rank
    _afford(problem, shots, r)
    turn = rank.determined / rank.values[:r]
    found = Descent(problem, turn, iterations).fit(solve(factor, rank).value, shots)
    back = rank.values[:r, None] * rank.vectors[:, :r].T * rank.scale
    information = back.T @ found.information @ back
    fit = of_information(found.value, information, rank, found.samples, found.notes)
    return OutputFit(found.value, replace(fit, weights=weights, correlated=True))


def _afford(problem: Problem, shots: Sequence[Shots], directions: int) -> None:
    """Raise InputError where the derivatives of all simulations need more memory than the budget has."""
    samples, n = sum(one.samples for one in shots), len(problem.model.joints)
    needed = WEIGHT * samples * n * (directions + 2 * n)
    if needed <= memory():
        return
    sources = ", ".join(dict.fromkeys(one.source for one in problem.motions))
    raise InputError(
        f"{sources}: the derivatives of the simulation, {samples} samples of each joint by {directions} directions of "
        f"the parameters, would take {amount(needed)} of memory, more than {amount(memory())}. Take a shorter `window` "
        f"({100 * memory() / needed:.2g} % of it fit), an estimator that simulates nothing, or raise this by --memory "
        f"or {MEMORY} (in GB)."
    )
