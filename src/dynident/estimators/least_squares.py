"""Ordinary least squares, eq. (11), from a triangular factor, with its covariance and rank."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.errors import ConfigError, changed, choices
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.linear import LinearFit, estimate_of, solve
from dynident.models import Parameter
from dynident.regression import Rank, TriangularFactors, rank_of

__all__ = ["LeastSquares", "Weights", "check_weights", "joint_weights", "weighted"]

Array = NDArray[np.float64]
Weights = Literal["equal", "per_joint"]
MOST = 1000  # iterations
COARSEST = 0.01  # tolerance of a rank: with more, columns that the data show are given up


def joint_weights(
    triangular: TriangularFactors,
    weights: Weights,
    iterations: int,
    parameters: Sequence[Parameter] = (),
    tolerance: float | None = None,
) -> Array:
    """Return the weight (n) of each joint: one, or with "per_joint" one over the standard deviation of its residual.

    Starting from equal weights, the deviations are those of the fit with the previous weights, until they change by
    less than 1 % or ``iterations`` are done: feasible generalised least squares, Gautier and Poignet (2001).
    """
    n = len(triangular.factors)
    found = np.ones(n)
    if weights == "equal":
        return found
    size = np.sqrt(np.square(triangular.factors[:, :, -1]).sum(axis=1) / np.maximum(triangular.rows, 1))
    # a joint with residuals at rounding level must not outweigh all others
    floor = 1e-7 * np.where(size > 0, size, size.max(initial=0.0) or 1.0)
    for _ in range(iterations):
        theta = solve(*weighted(triangular, found, parameters, tolerance)).value
        deviation = np.sqrt(triangular.residual(theta) / np.maximum(triangular.rows, 1))
        previous, found = found, 1.0 / np.maximum(deviation, floor)
        if np.allclose(found, previous, rtol=0.01, atol=0.0):
            break
    return found


def weighted(
    triangular: TriangularFactors,
    weights: Array,
    parameters: Sequence[Parameter] = (),
    tolerance: float | None = None,
    shown: Rank | None = None,
) -> tuple[Array, Rank]:
    """Return the factor of the rows times the ``weights`` (n) of their joints, and its rank.

    What the motion shows does not depend on the weights: the directions are those without them, or ``shown`` by rows
    that are not whitened.
    """
    if shown is not None:
        factor = triangular.stacked(weights)
        return factor, rank_of(factor, parameters, tolerance, shown)
    key = tuple(parameters), tolerance  # asked at each step of the weights
    if key not in triangular.known:
        plain = triangular.stacked()
        triangular.known[key] = plain, rank_of(plain, parameters, tolerance)
    plain, rank = triangular.known[key]
    if (weights == 1.0).all():
        return plain, rank
    factor = triangular.stacked(weights)
    return factor, rank_of(factor, parameters, tolerance, None if np.ptp(weights) == 0 else rank)


def check_weights(weights: str, iterations: int) -> None:
    """Raise ConfigError for invalid settings of ``joint_weights``."""
    if weights not in get_args(Weights):
        raise ConfigError(f"weights = {weights!r} of the joints; {choices(weights, get_args(Weights))}")
    if not 1 <= iterations <= MOST:
        raise ConfigError(f"iterations = {iterations} of the weights; give a whole number from 1 to {MOST}.")


@dataclass(frozen=True)
class LeastSquares:
    """Ordinary least squares, theta = (X' X)^-1 X' y, eq. (11); with ``weights`` "per_joint" weighted by joint.

    The rank is that of ``rank_of`` with ``tolerance`` (None: the precision of the model). The covariance is
    s^2 (X' X)^-1 with s^2 the residual variance: it holds for independent errors of equal variance and an exactly known
    regressor; with correlated residuals it is too small. Calling it with a ``Problem`` gives an ``Estimate``.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=dy.LeastSquares())
    >>> for name, value, std in zip(arm.names, found.estimate.value, found.estimate.std):
    ...     print(f"{name} = {value:.4f} +- {std:.5f}")
    J = 0.0824 +- 0.00007
    h = 0.2498 +- 0.00022
    """

    tolerance: Annotated[float, Gt(0), Le(COARSEST)] | None = None
    weights: Weights = "equal"
    iterations: Annotated[int, Ge(1), Le(MOST)] = 3

    __repr__ = changed

    def __post_init__(self) -> None:
        check_weights(self.weights, self.iterations)
        if self.tolerance is not None and not 0 < self.tolerance <= COARSEST:
            raise ConfigError(
                f"tolerance of the rank is {self.tolerance}; give a number between 0 and {COARSEST}, such as 1e-12."
            )

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; for a deficient rank a note names the parameters of which only combinations are identifiable."""
        return estimate_of(problem, self.reduced(problem))

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the rows with the weights of their joints."""
        triangular, parameters = problem.regression.triangular_factors, problem.model.parameters
        weights = joint_weights(triangular, self.weights, self.iterations, parameters, self.tolerance)
        factor, rank = weighted(triangular, weights, parameters, self.tolerance)
        return LinearFit(factor, rank, triangular.total, None if self.weights == "equal" else weights)
