"""The first model of an estimation by simulation: that of least squares, or where this fails another."""

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
from dynident.simulation import Failure

__all__ = ["first_runs"]

Array = NDArray[np.float64]
T = TypeVar("T")


def first_runs(
    problem: Problem, start: Array, simulated: Callable[[Array], T | Failure]
) -> tuple[Array, T, Start | None]:
    """Return the first parameters (p) that can be simulated, what is simulated, and what made them where
    ``start`` cannot.

    Least squares of a noisy motion can have a mass matrix that is not positive definite: then the physically consistent
    fit is tried, instrumental variables, which such noise does not bias, and the values that the model has from its
    file. Raises InputError where none can be simulated.
    """
    runs = simulated(start)
    if not isinstance(runs, Failure):
        return start, runs, None
    for kind, value in _others(problem):
        runs = simulated(value)
        if not isinstance(runs, Failure):
            return value, runs, kind
    what = (
        "no first model can be simulated, neither that of least squares nor a physically consistent one, one by "
        "instrumental variables or that of the robot file"
    )
    raise not_simulated(problem.motions, what, runs, "an estimator that simulates nothing")


def _others(problem: Problem) -> Iterator[tuple[Start, Array]]:
    """Yield other parameters to begin with, of those that can be had, the values of the robot file last."""
    others: dict[Start, Estimator] = {
        Start.CONSISTENT: PhysicallyConsistent(costs=False),
        Start.INSTRUMENTS: InstrumentalVariables(instruments="lagged"),
    }
    for kind, estimator in others.items():
        with suppress(DynidentError):
            yield kind, estimator(problem).value
    values = problem.model.values
    if values is not None and np.isfinite(values).all():
        yield Start.NOMINAL, np.asarray(values, dtype=float)
