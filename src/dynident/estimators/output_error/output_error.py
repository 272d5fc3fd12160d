"""Output error: the simulated positions are fitted to the measured ones, in closed loop or between restarts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.errors import ConfigError, changed, choices
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.least_squares import MOST, LeastSquares, joint_weights, weighted
from dynident.estimators.linear import estimate_of, of_information, solve
from dynident.estimators.output_error.descent import Descent
from dynident.estimators.output_error.first import no_controller
from dynident.estimators.output_error.shots import Shots, shots_of

__all__ = ["Loop", "OutputError"]

Array = NDArray[np.float64]
Loop = Literal["auto", "closed", "open"]
LONGEST = 1e4  # s


@dataclass(frozen=True)
class OutputError:
    """The theta whose simulated positions are nearest to the measured ones, each joint weighted by its noise.

    ``loop``: "closed" simulates the model in the loop of the recorded controller (``Log.controller``) under the recorded
    reference, from an unknown state at the start; "open" drives the model with the torque that was commanded
    (``Log.command``), else measured, in segments of ``segment`` (s), whose states at the start are all unknown (multiple
    shooting): an arm that would run away cannot. "auto" closes the loop where all recordings know their controller.

    Gauss and Newton's iteration with Levenberg's damping, by the exact derivatives of the discrete simulation. It begins
    with least squares, or, where this cannot be simulated, with the physically consistent fit; ``iterations`` is the
    most steps. The covariance allows for residuals that are correlated in time: noise of a measured torque that drives
    the model is in them, as is all that the model lacks. It counts errors of the positions, and of no torque: with a
    measured torque of much noise, maximum likelihood has smaller errors.

    Raises MissingInputError where the loop is to be closed and a recording does not know its controller, InputError where
    the first model cannot be simulated, ModelError for terms that remember, ConfigError for bad settings. References:
    Landau and Karimi (1997); Jubien, Gautier and Janot (2014); of multiple shooting, Bock (1983).
    """

    loop: Loop = "auto"
    segment: Annotated[float, Gt(0), Le(LONGEST)] | None = None
    iterations: Annotated[int, Ge(1), Le(MOST)] = 30

    __repr__ = changed

    def __post_init__(self) -> None:
        if self.loop not in get_args(Loop):
            raise ConfigError(f"loop = {self.loop!r}; {choices(self.loop, get_args(Loop))}")
        if self.segment is not None and not 0 < self.segment <= LONGEST:
            raise ConfigError(f"segment = {self.segment}; give a time (s) of at most {LONGEST:g}, or null.")
        if not 1 <= self.iterations <= MOST:
            raise ConfigError(f"iterations = {self.iterations}; give a whole number from 1 to {MOST}.")

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; a note says where the iteration did not converge."""
        triangular, parameters = problem.regression.triangular_factors, problem.model.parameters
        weights = joint_weights(triangular, "per_joint", 3, parameters)
        factor, rank = weighted(triangular, weights, parameters)
        found = Descent(problem, self._shots(problem), rank, self.iterations).fit(solve(factor, rank).value)
        fit = of_information(found.value, found.information, rank, found.rows, found.notes)
        estimate = estimate_of(problem, replace(fit, weights=weights))
        return replace(estimate, value=found.value, residual=fit.residual(problem, found.value))

    def quick(self) -> LeastSquares:
        """Return least squares: a search needs no simulation."""
        return LeastSquares(weights="per_joint")

    def _shots(self, problem: Problem) -> tuple[Shots, ...]:
        """Return what is to be simulated of each recording."""
        found = tuple(shots_of(problem, k, self.segment) for k in range(len(problem.motions)))
        known = [one.controller is not None for one in found]
        if self.loop == "closed" and not all(known):
            raise no_controller(problem.motions[known.index(False)])
        return found if self.loop != "open" and all(known) else tuple(one.opened() for one in found)
