"""The first model of an estimation by simulation: that of least squares, or where this fails another."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, MissingInputError
from dynident.estimators.estimator import Problem
from dynident.estimators.instrumental_variables import InstrumentalVariables
from dynident.estimators.instrumental_variables.simulated import reason_of
from dynident.estimators.output_error.notes import Start
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.log import Motion
from dynident.simulation import Failure

__all__ = ["first_runs", "no_controller"]

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
    raise _failed(problem, runs)


def _others(problem: Problem) -> Iterator[tuple[Start, Array]]:
    """Yield other parameters to begin with, those of the model's file last."""
    yield Start.CONSISTENT, PhysicallyConsistent(costs=False)(problem).value
    yield Start.INSTRUMENTS, InstrumentalVariables(instruments="lagged")(problem).value
    if problem.model.values is not None:
        yield Start.NOMINAL, np.asarray(problem.model.values, dtype=float)


def no_controller(motion: Motion) -> MissingInputError:
    """Return the error where a recording has no controller."""
    return MissingInputError(
        f"{motion.source}: the closed loop is to be simulated, but the recording does not know its controller. Give its "
        "gains and reference in the section `simulation` (kinds cascade, pd, pid, python; in Python Log.controller)."
    )


def _failed(problem: Problem, failure: Failure) -> InputError:
    return InputError(
        f"{', '.join(one.source for one in problem.motions)}: no first model can be simulated, neither that of least "
        "squares nor a physically consistent one, one by instrumental variables or that of the file "
        f"({reason_of(failure)}). Check gains, units and reference of the controller and the terms of the model, or use "
        "an estimator that simulates nothing."
    )
