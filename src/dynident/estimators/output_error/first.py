"""The first model of an estimation by simulation: least squares, or where this fails in the loop, a consistent one."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, MissingInputError
from dynident.estimators.estimator import Problem
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.log import Motion
from dynident.simulation import Failure, RunsAway, Singular

__all__ = ["first_runs", "no_controller"]

Array = NDArray[np.float64]
T = TypeVar("T")


def first_runs(problem: Problem, start: Array, simulated: Callable[[Array], T | Failure]) -> tuple[Array, T, bool]:
    """Return the first parameters (p) that can be simulated, what is simulated, and whether they are consistent ones.

    Raises InputError where neither ``start`` nor the physically consistent fit can be.
    """
    runs = simulated(start)
    if not isinstance(runs, Failure):
        return start, runs, False
    value = PhysicallyConsistent(costs=False)(problem).value
    runs = simulated(value)
    if isinstance(runs, Failure):
        raise _failed(problem, runs)
    return value, runs, True


def no_controller(motion: Motion) -> MissingInputError:
    """Return the error where a recording has no controller."""
    return MissingInputError(
        f"{motion.source}: the closed loop is to be simulated, but the recording does not know its controller. Give its "
        "gains and reference in the section `simulation` (kinds cascade, pd, pid, python; in Python Log.controller)."
    )


def _failed(problem: Problem, failure: Failure) -> InputError:
    if isinstance(failure, RunsAway):
        why = f"it runs away after {failure.after:.3g} s"
    else:
        why = "its mass matrix is singular" if isinstance(failure, Singular) else f"{failure}"
    return InputError(
        f"{', '.join(one.source for one in problem.motions)}: the first model cannot be simulated, neither that of least "
        f"squares nor the physically consistent one ({why}). Check gains, units and reference of the controller and the "
        "terms of the model, or use an estimator that simulates nothing."
    )
