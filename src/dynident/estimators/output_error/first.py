"""The first model of an estimation by simulation: of some fits the one whose simulation is nearest to the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import DynidentError, Step
from dynident.estimators.estimator import Problem
from dynident.estimators.first_model import other_model
from dynident.estimators.instrumental_variables import InstrumentalVariables
from dynident.estimators.loops import not_simulated
from dynident.estimators.notes import Start
from dynident.estimators.resmoothed import resmoothed
from dynident.simulation import Failure
from dynident.smoothers import Spline

__all__ = ["first_runs"]

Array = NDArray[np.float64]
T = TypeVar("T")
FITS = 3  # that are tried
NEARER = 0.5  # of the cost: below it, another first model is worth it


def first_runs(
    problem: Problem, start: Array, simulated: Callable[[Array], T | Failure], cost: Callable[[T], float]
) -> tuple[Array, T, Start | None]:
    """Return the first parameters (p), what is simulated with them, and what made them where it is not ``start``.

    A simulation has several minima. Noise that differentiation makes large biases least squares away from the right
    one: least squares of a smoothing spline, and instrumental variables, which white noise does not bias, are tried
    beside, and the one of least cost is taken. Where none of these can be simulated, it is one of ``other_model``.
    Raises InputError where no one can.
    """
    best: tuple[Array, T, Start | None] | None = None
    least = np.inf
    failures: list[Failure] = []
    for k, (kind, value) in enumerate(_fits(problem, start)):
        problem.progress(Step("simulating first models", k, FITS))
        runs = simulated(value)
        if isinstance(runs, Failure):
            failures.append(runs)
        elif best is None or cost(runs) < NEARER * least:
            best, least = (value, runs, kind), cost(runs)
    if best is not None:
        return best
    other = other_model(problem, failures[0], simulated)
    if isinstance(other, Failure):
        raise not_simulated(problem.motions, other, "an estimator that simulates nothing")
    return other


def _fits(problem: Problem, start: Array) -> Iterator[tuple[Start | None, Array]]:
    """Yield least squares, and other fits that differ from it."""
    yield None, start
    with suppress(DynidentError):
        value = resmoothed(problem, Spline())
        if not np.allclose(value, start, rtol=1e-3):
            yield Start.SMOOTHED, value
    with suppress(DynidentError):
        yield Start.INSTRUMENTS, InstrumentalVariables(instruments="lagged")(problem).value
