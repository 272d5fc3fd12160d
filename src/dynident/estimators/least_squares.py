"""Ordinary least squares, eq. (11), from a triangular factor, with its covariance and rank."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.errors import ConfigError, Note, brief, changed, choices
from dynident.estimators.estimator import Determined, Estimate, Problem, Residual
from dynident.estimators.notes import RankDeficient
from dynident.models import Parameter
from dynident.regression import Rank, TriangularFactors, rank_of

__all__ = ["LeastSquares", "LeastSquaresSolution", "Weights", "check_weights", "joint_weights", "solve", "weighted"]

Array = NDArray[np.float64]
Weights = Literal["equal", "per_joint"]
MOST = 1000  # iterations
COARSEST = 0.01  # tolerance of a rank: with more, columns that the data show are given up


@dataclass(frozen=True, eq=False)
class LeastSquaresSolution:
    """A least-squares solution: ``value`` (p) (of least norm in scaled columns where the rank is deficient).

    ``rss`` is the sum of squared residuals, ``directions`` the rank with the directions that it determines.
    """

    value: Array
    rss: float
    directions: Rank

    __repr__ = brief

    @property
    def rank(self) -> int:
        """Number of directions that the data determine."""
        return self.directions.rank

    @property
    def inverse(self) -> Array:
        """(X' X)^-1 on the determined directions (p, p)."""
        return self.directions.inverse

    @property
    def condition(self) -> float:
        """Ratio of the largest to the smallest singular value of the scaled columns."""
        return self.directions.condition

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Groups of parameters of which only combinations are identifiable, by index."""
        return self.directions.groups


def solve(factor: Array, rank: Rank | None = None) -> LeastSquaresSolution:
    """Solve min |X theta - y| from the R factor (p + 1, p + 1) of [X | y], on the directions that ``rank`` determines.

    ``rank`` is that of the factor, by default the numerical one. ``condition`` is the ratio of the largest to the
    smallest of all singular values of the scaled columns (inf where one is zero).
    """
    rank = rank or rank_of(factor)
    p, r = len(factor) - 1, rank.rank
    R, y = factor[:p, :p] / rank.scale, factor[:p, p]
    known = rank.vectors[:, :r]
    value = np.linalg.solve(R, y) if r == p else known @ ((rank.left[:, :r].T @ y) / rank.values[:r])
    rest = float(np.sum((y - R @ value) ** 2)) + float(factor[p, p] ** 2)
    return LeastSquaresSolution(value / rank.scale, rest, rank)


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
    triangular: TriangularFactors, weights: Array, parameters: Sequence[Parameter] = (), tolerance: float | None = None
) -> tuple[Array, Rank]:
    """Return the factor of the rows times the ``weights`` (n) of their joints, and its rank.

    What the motion shows does not depend on the weights: the directions are those without them.
    """
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
        triangular, model = problem.regression.triangular_factors, problem.model
        parameters = model.parameters
        weights = joint_weights(triangular, self.weights, self.iterations, parameters, self.tolerance)
        fit = solve(*weighted(triangular, weights, parameters, self.tolerance))
        return Estimate(
            parameters=parameters,
            value=fit.value,
            covariance=fit.directions.covariance(fit.rss / max(triangular.total - fit.rank, 1)),
            determined=Determined(fit.rank, fit.condition, fit.directions),
            residual=Residual(
                np.sqrt(triangular.residual(fit.value) / np.maximum(triangular.rows - 1, 1)),
                triangular.samples,
                None if self.weights == "equal" else weights,
            ),
            notes=_notes(fit, model.names),
        )


def _notes(fit: LeastSquaresSolution, names: tuple[str, ...]) -> tuple[Note, ...]:
    if not fit.groups:
        return ()
    lone = tuple(names[group[0]] for group in fit.groups if len(group) == 1)
    tied = tuple(tuple(names[k] for k in group) for group in fit.groups if len(group) > 1)
    return (RankDeficient(fit.rank, len(names), lone, tied),)
