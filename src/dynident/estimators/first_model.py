"""First models besides least squares, for what simulates or filters: where that cannot be simulated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import DynidentError, ModelError, Step
from dynident.estimators.constraints import with_mass
from dynident.estimators.estimator import Estimator, Problem
from dynident.estimators.least_squares import LeastSquares
from dynident.estimators.maximum_likelihood.measured import feasible
from dynident.estimators.notes import Start
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.estimators.resmoothed import resmoothed
from dynident.simulation import Failure
from dynident.smoothers import KalmanSmoother

__all__ = ["other_model"]

Array = NDArray[np.float64]
T = TypeVar("T")
OTHERS = 4  # that are tried
POSES = 32  # at which the mass matrix must be positive definite
COSTLY = 1.1  # residual of a joint over that of least squares: noise alone does not leave so much more


def other_model(
    problem: Problem, failure: Failure, tried: Callable[[Array], T | Failure]
) -> tuple[Array, T, Start] | Failure:
    """Return the first parameters (p) that can be ``tried``, what comes of them, and what made them.

    These are least squares of a Kalman smoother, whose acceleration has the least noise; the physically consistent fit;
    the values that the model has from its file; and at last least squares under the constraint that the mass matrix is
    positive definite where the robot was. Where none can, it is the ``failure`` of least squares.
    """
    for k, (kind, value) in enumerate(_others(problem)):
        problem.progress(Step("trying other first models", k, OTHERS))
        found = tried(value)
        if not isinstance(found, Failure):
            return value, found, kind
    return failure


def _others(problem: Problem) -> Iterator[tuple[Start, Array]]:
    with suppress(DynidentError):
        yield Start.KALMAN, resmoothed(problem, KalmanSmoother())
    consistent: Estimator = PhysicallyConsistent(costs=False)
    with suppress(DynidentError):
        yield Start.CONSISTENT, consistent(problem).value
    values = problem.model.values
    if values is not None and np.isfinite(values).all():
        yield Start.NOMINAL, np.asarray(values, dtype=float)
    with suppress(DynidentError):
        yield Start.MASS, _massive(problem)


def _massive(problem: Problem) -> Array:
    """Return least squares (p) under the constraint that the mass matrix is positive definite at some of the poses.

    Raises ModelError where the data contradict that, as a torque of the wrong sign does.
    """
    model, triangular = problem.model, problem.regression.triangular_factors
    q = np.concatenate([one.q[one.mask] for one in problem.motions])
    physical = with_mass(model, q[:: max(len(q) // POSES, 1)])
    size = len(model.names)
    wanted = (*physical.matrices, *physical.numbers(np.zeros(size), np.eye(size)))
    start = LeastSquares(weights="per_joint")(problem).value
    found = feasible(start, problem, wanted)
    if (triangular.residual(found) > COSTLY**2 * triangular.residual(start)).any():
        raise ModelError("the data contradict a positive definite mass matrix.")
    return found
