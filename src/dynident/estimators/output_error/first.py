"""The first model of an estimation by simulation: of some fits the one whose simulation is nearest to the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import DynidentError
from dynident.estimators.estimator import Estimator, Problem
from dynident.estimators.instrumental_variables import InstrumentalVariables
from dynident.estimators.loops import not_simulated
from dynident.estimators.output_error.notes import Start
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.estimators.resmoothed import resmoothed
from dynident.simulation import Failure
from dynident.smoothers import KalmanSmoother, Spline

__all__ = ["first_runs"]

Array = NDArray[np.float64]
T = TypeVar("T")
NEARER = 0.5  # of the cost: below it, another first model is worth it


def first_runs(
    problem: Problem, start: Array, simulated: Callable[[Array], T | Failure], cost: Callable[[T], float]
) -> tuple[Array, T, Start | None]:
    """Return the first parameters (p), what is simulated with them, and what made them where it is not ``start``.

    A simulation has several minima. Noise that differentiation makes large biases least squares away from the right
    one: least squares of a smoothing spline, and instrumental variables, which white noise does not bias, are tried
    beside, and the one of least cost is taken. Where none of these can be simulated, as a mass matrix is not positive
    definite, it is least squares of a Kalman smoother, whose acceleration has the least noise, the physically
    consistent fit, or the values that the model has from its file. Raises InputError where no one can.
    """
    best: tuple[Array, T, Start | None] | None = None
    least, failure = np.inf, None
    for kind, value in _fits(problem, start):
        runs = simulated(value)
        if isinstance(runs, Failure):
            failure = runs
        elif best is None or cost(runs) < NEARER * least:
            best, least = (value, runs, kind), cost(runs)
    if best is not None:
        return best
    for kind, value in _others(problem):
        runs = simulated(value)
        if not isinstance(runs, Failure):
            return value, runs, kind
        failure = runs
    what = (
        "no first model can be simulated, neither that of least squares nor a physically consistent one, one by "
        "instrumental variables or that of the robot file"
    )
    assert failure is not None  # noqa: S101 - that of start
    raise not_simulated(problem.motions, what, failure, "an estimator that simulates nothing")


def _fits(problem: Problem, start: Array) -> Iterator[tuple[Start | None, Array]]:
    """Yield least squares, and other fits that differ from it."""
    yield None, start
    with suppress(DynidentError):
        value = resmoothed(problem, Spline())
        if not np.allclose(value, start, rtol=1e-3):
            yield Start.SMOOTHED, value
    with suppress(DynidentError):
        yield Start.INSTRUMENTS, InstrumentalVariables(instruments="lagged")(problem).value


def _others(problem: Problem) -> Iterator[tuple[Start, Array]]:
    """Yield parameters that can be simulated more often, those of the robot file last."""
    with suppress(DynidentError):
        yield Start.KALMAN, resmoothed(problem, KalmanSmoother())
    consistent: Estimator = PhysicallyConsistent(costs=False)
    with suppress(DynidentError):
        yield Start.CONSISTENT, consistent(problem).value
    values = problem.model.values
    if values is not None and np.isfinite(values).all():
        yield Start.NOMINAL, np.asarray(values, dtype=float)
