"""Feasible generalised least squares: the noise from the residual, the fit to rows whitened by it, and again.

Aitken's estimate (X' V^-1 X)^-1 X' V^-1 y with V of the last residual, until the parameters stand still: Cochrane and
Orcutt (1949) for noise that is coloured in time, Zellner (1962) for equations whose noise is correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, Note, Step
from dynident.estimators.estimator import Problem
from dynident.estimators.least_squares import COARSEST, MOST, joint_weights, weighted
from dynident.estimators.linear import LinearFit, solve
from dynident.estimators.noise import Residuals, Series
from dynident.estimators.notes import NotConverged, StillColoured, WhiteningCostly
from dynident.estimators.specification import Apart
from dynident.models import Parameter
from dynident.regression import Rank, Regression, TriangularFactors, Whitening

__all__ = ["check_feasible", "feasible"]

Array = NDArray[np.float64]
START = 3  # iterations of the weights of the joints
SETTLED = 3  # rounds after which the orders stay
CLOSE = 0.01  # root mean square step of the parameters that is none, in standard errors
ROUNDING = 1e-7  # of the torque: a smaller residual is no noise
COSTLY = 1.1  # residual of a joint over that of least squares that is said
COLOURED = 0.1  # correlation of whitened residuals that is said


def check_feasible(tolerance: float | None, iterations: int) -> None:
    """Raise ConfigError for settings of ``feasible`` that cannot be."""
    if tolerance is not None and not 0 < tolerance <= COARSEST:
        raise ConfigError(
            f"tolerance of the rank is {tolerance}; give a number between 0 and {COARSEST}, such as 1e-12."
        )
    if not 1 <= iterations <= MOST:
        raise ConfigError(f"iterations = {iterations} of the noise; give a whole number from 1 to {MOST}.")


def feasible(problem: Problem, most: int, iterations: int, tolerance: float | None = None) -> LinearFit:
    """Return the rows of a problem, whitened by autoregressions of at most the order ``most`` and the covariance of
    their innovations, which are those of the fit itself.

    It ends, with a note, where the fit leaves much more of the torque than least squares: from there the parameters
    would move on, to explain what whitening has left; of noise alone the first steps are nearly all there is to gain.
    The note says whether such noise explains it. Raises ConfigError for a regression that holds factors alone.
    """
    if not problem.regression.motions:
        raise ConfigError("estimator: whitening needs all samples; take least squares or the consistent fit.")
    plain, parameters = replace(problem.regression, weights=(), whitening=None), problem.model.parameters
    triangular = problem.regression.triangular_factors
    weights = joint_weights(triangular, "per_joint", START, parameters, tolerance)
    first, shown = weighted(triangular, weights, parameters, tolerance)
    start = value = solve(first, shown).value
    floor, names = _floor(triangular), [joint.name for joint in problem.model.joints]
    orders: Sequence[int] | None = None
    costly: WhiteningCostly | None = None
    for k in range(iterations):
        problem.progress(Step("whitening", k, iterations))
        noise = Residuals.of(plain, value, floor).noise(most, shown.rank, orders)
        orders = noise.orders if k + 1 >= SETTLED else None
        factor, rank = _whitened(plain, noise, shown, parameters, tolerance)
        step, value = _step(factor, rank, value, triangular.total)
        costly = _costly(triangular, value, start, floor, names)
        if step < CLOSE or costly:
            break
    if costly:
        apart = Apart(plain, weights, first, shown)
        costly = replace(costly, chance=apart.chance(value - start, noise, rank, problem.progress))
    unsettled = step >= CLOSE and not costly
    notes = (
        *((NotConverged(iterations, 0.5 * rank.rank * step**2),) if unsettled else ()),
        *(_coloured(Residuals.of(plain, value, floor).innovations(noise), floor, names) if most else ()),
        *((costly,) if costly else ()),
    )
    return LinearFit(factor, rank, triangular.total, notes=notes, whitening=noise)


def _floor(triangular: TriangularFactors) -> Array:
    """Return for each joint (n) the deviation below which a residual is rounding."""
    size = np.sqrt(np.square(triangular.factors[:, :, -1]).sum(axis=1) / np.maximum(triangular.rows, 1))
    return np.asarray(ROUNDING * np.where(size > 0, size, size.max(initial=0.0) or 1.0))


def _whitened(
    plain: Regression, noise: Whitening, shown: Rank, parameters: Sequence[Parameter], tolerance: float | None
) -> tuple[Array, Rank]:
    triangular = replace(plain, whitening=noise).triangular_factors
    return weighted(triangular, np.ones(len(triangular.rows)), parameters, tolerance, shown)


def _step(factor: Array, rank: Rank, before: Array, total: int) -> tuple[float, Array]:
    """Return the new value, and its root mean square step in standard errors; zero where that is rounding."""
    found = solve(factor, rank)
    moved = float(np.linalg.norm(factor[:, :-1] @ (found.value - before)))
    if moved <= ROUNDING * np.linalg.norm(factor[:, -1]):
        return 0.0, found.value
    return moved / np.sqrt(max(rank.rank, 1) * found.rss / max(total - rank.rank, 1)), found.value


def _coloured(left: Series, floor: Array, names: Sequence[str]) -> tuple[Note, ...]:
    """Return a note on the joint whose whitened residual has the largest correlation over time, where that is large."""
    real = np.sqrt(np.square(left.values).sum(axis=1) / np.maximum(left.used.sum(axis=1), 1)) > floor
    largest = [np.abs(left.correlations(j)).max(initial=0.0) * real[j] for j in range(len(names))]
    worst = int(np.argmax(largest))
    return (StillColoured(names[worst], float(largest[worst])),) if largest[worst] > COLOURED else ()


def _costly(
    triangular: TriangularFactors, value: Array, start: Array, floor: Array, names: Sequence[str]
) -> WhiteningCostly | None:
    """Return a note where the fit leaves much more of a joint's torque than least squares."""
    now, before = (np.sqrt(triangular.residual(x) / np.maximum(triangular.rows, 1)) for x in (value, start))
    ratio = np.divide(now, before, out=np.ones_like(now), where=before > floor)
    worst = int(ratio.argmax())
    return WhiteningCostly(names[worst], float(ratio[worst])) if ratio[worst] > COSTLY else None
