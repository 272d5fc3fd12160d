"""Least squares of rows that are whitened by the noise of their own residual, which ``noise`` estimates.

The noise is an autoregression for each joint and the covariance of the innovations; the order is zero for
``WeightedLeastSquares``. ``regression.whitening`` whitens the rows, ``least_squares`` solves them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from dynident.estimators.estimator import Problem
from dynident.estimators.least_squares import (
    MAX_ITERATIONS,
    ROUNDING,
    LinearFit,
    SampledEstimator,
    rounding_floor,
    rows_by_joint,
    solve_least_squares,
    weight_joints,
)
from dynident.estimators.noise import HausmanTest, Residuals, ResidualSeries
from dynident.estimators.notes import NotConverged, StillColoured, WhiteningCostly
from dynident.regression import Rank, TriangularFactors
from dynident.runtime import ConfigError, Note, Step, report_progress
from dynident.runtime.arrays import Array

MAX_ORDER = 200  # order
ORDER_ROUNDS = 3  # rounds after which the orders stay
MIN_STEP = 0.01  # root mean square step of the parameters that is none, in standard errors
MAX_RESIDUAL_RATIO = 1.1  # residual of a joint over that of least squares that is said
MAX_CORRELATION = 0.1  # correlation of whitened residuals that is said


@dataclass(frozen=True)
class GeneralisedLeastSquares(SampledEstimator):
    """Least squares for noise that is coloured in time and correlated between joints, (X' V^-1 X)^-1 X' V^-1 y.

    The noise of each joint is an autoregression, of the order with the least Bayesian information criterion up to
    ``max_order``; rows are prewhitened by it, and mixed by the covariance of the innovations of all joints. The noise
    is that of the residual of the fit itself, which is repeated until the parameters stand still, at most
    ``iterations`` times (Cochrane and Orcutt, 1949). The covariance is s^2 (X' V^-1 X)^-1.

    It is the best linear fit where the residual is noise. Where it is what the model lacks, slow and following the
    motion, prewhitening takes the slow part of the torque away with it, and fits what is left, where noise of the
    smoothed motion is largest. A note says where the whitened residual is still coloured; where the fit leaves 1.1
    times as much of the torque of a joint as least squares, the iteration ends, and another says whether 99 simulations
    of the noise explain it (Hausman, 1978).

    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from scipy.signal import lfilter
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-8, sigma_tau=0.0, rng=rng).log
    >>> noise = lfilter([1.0], [1.0, -0.9], 0.01 * rng.standard_normal(1001))
    >>> log = replace(log, tau=log.tau + noise[:, None])
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-8), estimator=dy.GeneralisedLeastSquares())
    >>> (a,) = found.estimate.residual.whitening.coefficients
    >>> print(a.round(2))
    [0.89]
    """

    max_order: Annotated[int, Ge(1), Le(MAX_ORDER)] = 20
    iterations: Annotated[int, Ge(1), Le(MAX_ITERATIONS)] = 10

    title = "generalised least squares, with autoregressive noise"

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the whitened rows; notes tell where the residual is more than noise."""
        return fit_whitened(problem, self.max_order, self.iterations)


@dataclass(frozen=True)
class WeightedLeastSquares(SampledEstimator):
    """Least squares weighted by the noise of all joints and its correlation between them, (X' V^-1 X)^-1 X' V^-1 y.

    The covariance S (n, n) of V is that of the residual of the fit itself, which is repeated until the parameters stand
    still (Zellner, 1962; in robotics with variances alone: Gautier, 1997). Correlations that may be chance are drawn to
    zero, or left out. The noise is taken as white in time, as ``GeneralisedLeastSquares`` does not. ``iterations`` is
    the largest number of fits. The covariance is s^2 (X' V^-1 X)^-1.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import two_link_arm
    >>> arm, t, rng = two_link_arm(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(3 * s), np.cos(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-5, sigma_tau=0.01, rng=rng).log
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-5), estimator=dy.WeightedLeastSquares())
    >>> found.estimate.residual.whitening.orders
    (0, 0)
    """

    iterations: Annotated[int, Ge(1), Le(MAX_ITERATIONS)] = 10

    title = "least squares, weighted by the noise of all joints"

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the rows, mixed so that their noise is independent.

        A note tells where that leaves much more of the torque than least squares.
        """
        return fit_whitened(problem, 0, self.iterations)


def fit_whitened(problem: Problem, max_order: int, iterations: int) -> LinearFit:
    """Return the fit to the rows of a problem, whitened by the noise of its own residual.

    The noise is an autoregression of at most the order ``max_order`` for each joint, and the covariance of their
    innovations. The iteration ends, with a note, where the fit leaves much more of the torque than least squares:
    from there on the parameters would move to explain what whitening has left, while for pure noise the first
    steps gain nearly everything. The note tells whether noise explains it. Raises ConfigError for a regression
    that holds factors alone.
    """
    if not problem.regression.motions:
        raise ConfigError("estimator: whitening needs all samples; take least squares or the consistent fit.")
    regression, parameters = replace(problem.regression, weights=(), whitening=None), problem.model.parameters
    triangular = problem.regression.triangular_factors
    plain = rows_by_joint(problem)
    unwhitened_rank, start, value = plain.directions, plain.solution.value, plain.solution.value
    floor, names = rounding_floor(triangular), [joint.name for joint in problem.model.joints]
    orders: Sequence[int] | None = None
    costly_note: WhiteningCostly | None = None
    # alternate between the noise of the last residual and the fit to rows whitened by it
    for k in range(iterations):
        report_progress(Step("whitening", k, iterations))
        noise = Residuals.of(regression, value, floor).noise(max_order, unwhitened_rank.rank, orders)
        # changing orders would keep the parameters moving: after a few rounds only the coefficients are estimated anew
        orders = noise.orders if k + 1 >= ORDER_ROUNDS else None
        whitened = replace(regression, whitening=noise).triangular_factors
        factor, rank = weight_joints(whitened, np.ones(len(floor)), parameters, unwhitened_rank=unwhitened_rank)
        step, value = _update_parameters(factor, rank, value, triangular.total)
        costly_note = _costly_note(triangular, value, start, floor, names)
        if step < MIN_STEP or costly_note:
            break
    # simulate whether noise alone explains that the fit leaves more of the torque
    if costly_note:
        costly_note = replace(costly_note, chance=HausmanTest(regression, plain).is_chance(value - start, noise, rank))
    unsettled = step >= MIN_STEP and not costly_note
    notes = (
        *((NotConverged(iterations, 0.5 * rank.rank * step**2),) if unsettled else ()),
        *(_colour_notes(Residuals.of(regression, value, floor).innovations(noise), floor, names) if max_order else ()),
        *((costly_note,) if costly_note else ()),
    )
    return LinearFit(factor, rank, triangular.total, notes=notes, whitening=noise)


def _update_parameters(factor: Array, rank: Rank, previous: Array, total: int) -> tuple[float, Array]:
    """Return the root mean square step in standard errors, and the new value; the step is zero where it is rounding."""
    solution = solve_least_squares(factor, rank)
    change = float(np.linalg.norm(factor[:, :-1] @ (solution.value - previous)))
    # for exact data any step is rounding, whatever it is in standard errors
    if change <= ROUNDING * np.linalg.norm(factor[:, -1]):
        return 0.0, solution.value
    return change / np.sqrt(max(rank.rank, 1) * solution.rss / max(total - rank.rank, 1)), solution.value


def _colour_notes(innovations: ResidualSeries, floor: Array, names: Sequence[str]) -> tuple[Note, ...]:
    """Return a note on the joint whose whitened residual has the largest correlation over time, where that is large."""
    is_noise = (
        np.sqrt(np.square(innovations.values).sum(axis=1) / np.maximum(innovations.is_used.sum(axis=1), 1)) > floor
    )
    largest = [np.abs(innovations.correlations(j)).max(initial=0.0) * is_noise[j] for j in range(len(names))]
    worst = int(np.argmax(largest))
    return (StillColoured(names[worst], float(largest[worst])),) if largest[worst] > MAX_CORRELATION else ()


def _costly_note(
    triangular: TriangularFactors, value: Array, start: Array, floor: Array, names: Sequence[str]
) -> WhiteningCostly | None:
    """Return a note where the fit leaves much more of a joint's torque than least squares."""
    current, initial = (np.sqrt(triangular.residual(x) / np.maximum(triangular.rows, 1)) for x in (value, start))
    ratio = np.divide(current, initial, out=np.ones_like(current), where=initial > floor)
    worst = int(ratio.argmax())
    return WhiteningCostly(names[worst], float(ratio[worst])) if ratio[worst] > MAX_RESIDUAL_RATIO else None
