"""Ordinary least squares, eq. (11), from a triangular factor; what all estimators share that are linear.

A ``LinearEstimator`` reduces its rows to a ``LinearFit``, whose ``estimate`` is that without constraints.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from dynident.estimators.estimator import DataRank, Estimate, Estimator, Problem, Residual
from dynident.estimators.notes import RankDeficient
from dynident.models import Parameter
from dynident.regression import Rank, TriangularFactors, Whitening, rank_of
from dynident.runtime import Note, Noun, call_part, settings_text
from dynident.runtime.arrays import Array

Weights = Literal["equal", "per_joint"]
MAX_ITERATIONS = 1000  # iterations
ROUNDING = 1e-7  # of the torque: a smaller residual is no noise
MAX_RANK_TOLERANCE = 0.01  # tolerance of a rank: with more, columns that the data show are given up


class LeastSquaresSolution(Noun):
    """A least-squares solution: ``value`` (p) (of least norm in scaled columns where the rank is deficient).

    ``rss`` is the sum of squared residuals, ``directions`` the rank with the directions that it determines.
    """

    value: Array
    rss: float
    directions: Rank


def solve_least_squares(factor: Array, rank: Rank | None = None) -> LeastSquaresSolution:
    """Solve min |X theta - y| from the R factor (p + 1, p + 1) of [X | y], on the directions that ``rank`` determines.

    ``rank`` is that of the factor, by default the numerical one.
    """
    rank = rank or rank_of(factor)
    p, r = len(factor) - 1, rank.rank
    R, y = factor[:p, :p] / rank.scale, factor[:p, p]
    vectors = rank.vectors[:, :r]
    # the truncated solution has the least norm in scaled columns
    value = np.linalg.solve(R, y) if r == p else vectors @ ((rank.left_vectors[:, :r].T @ y) / rank.values[:r])
    residual_square = float(np.sum((y - R @ value) ** 2)) + float(factor[p, p] ** 2)
    return LeastSquaresSolution(value / rank.scale, residual_square, rank)


class LinearFit(Noun):
    """Weighted rows [X | y] of a problem, reduced to the triangular ``factor`` (p + 1, p + 1) of ``total`` rows.

    ``directions`` are the directions of the parameters that they determine. The weighting is described as in
    ``Residual``: ``weights`` (n), ``sample_weights`` (N, n) of each motion with their ``slopes``, and
    ``whitening``. Where errors of the motion count in the fit, ``information`` (p, p) includes them; with
    residuals that are ``correlated`` it accounts for that. ``sigma`` (n) is the standard deviation of each
    joint's residual where that is not its rms. Where a prior was added, ``plain`` is the fit without it: the
    shift by the prior may be an error. ``value`` (p) is the estimate where it differs from the solution along
    what the data do not determine. ``notes`` tell what was not as it should be.
    """

    factor: Array
    directions: Rank
    total: int
    weights: Array | None = None
    sample_weights: tuple[Array, ...] = ()
    slopes: tuple[Array, ...] = ()
    information: Array | None = None
    notes: tuple[Note, ...] = ()
    whitening: Whitening | None = None
    sigma: Array | None = None
    correlated: bool = False
    plain: LinearFit | None = None
    value: Array | None = None

    @classmethod
    def from_information(
        cls, value: Array, information: Array, directions: Rank, total: int, notes: tuple[Note, ...]
    ) -> LinearFit:
        """Return a fit with the solution ``value`` (p) and the inverse covariance ``information`` (p, p).

        ``directions`` are those that the data determine, such as the rank of the regressor, ``total`` the number of
        rows behind them. For estimators that are linear but no least squares of rows, such as instrumental variables.
        """
        rank = directions.with_information(information)
        p, r = len(value), rank.rank
        # rows whose normal equations are the information, so that constraints can be added as to any fit
        factor = np.zeros((p + 1, p + 1))
        factor[:r, :p] = rank.values[:r, None] * rank.vectors[:, :r].T * rank.scale
        factor[:p, p] = factor[:p, :p] @ value
        factor[p, p] = np.sqrt(max(total - r, 1))  # so that the variance of a row is one
        factor_rank = Rank(r, rank.scale, rank.values, np.eye(p), rank.vectors, rank.tolerance, rank.unweighted)
        return cls(factor, factor_rank, total, information=information, notes=notes)

    @property
    def solution(self) -> LeastSquaresSolution:
        """The solution without constraints."""
        return solve_least_squares(self.factor, self.directions)

    @property
    def variance(self) -> float:
        """The variance of the weighted residual."""
        return self.solution.rss / max(self.total - self.directions.rank, 1)

    @property
    def covariance(self) -> Array:
        """The covariance (p, p) of the solution without constraints and without a prior."""
        return self.directions.covariance(self.variance) if self.plain is None else self.plain.covariance

    def residual(self, problem: Problem, value: Array) -> Residual:
        """Return the residual of a problem at ``value`` (p)."""
        triangular = problem.regression.triangular_factors
        rms = np.sqrt(triangular.residual(value) / np.maximum(triangular.rows - 1, 1))
        weighting = self.weights, self.sample_weights, self.slopes
        sigma = rms if self.sigma is None else self.sigma
        return Residual(sigma, triangular.samples, *weighting, whitening=self.whitening, correlated=self.correlated)

    def estimate(self, problem: Problem) -> Estimate:
        """Return the estimate without constraints, (X' X)^-1 X' y, and s^2 (X' X)^-1, eq. (11)."""
        value = self.solution.value if self.value is None else self.value
        return Estimate(
            parameters=problem.model.parameters,
            value=value,
            covariance=self.covariance,
            determined=DataRank(self.directions.rank, self.directions.condition, self.directions),
            residual=self.residual(problem, value),
            notes=(*_rank_notes(self.directions, problem.model.names), *self.notes),
            information=self.information,
        )


class LinearEstimator(Estimator):
    """Base of the estimators that are linear in the parameters: constraints can be put on their rows."""

    @abstractmethod
    def reduced(self, problem: Problem) -> LinearFit:
        """Return the reduced rows of the problem."""

    def rows(self, problem: Problem) -> LinearFit:
        """Return the reduced rows, computed once for each problem: the consistent fit shares those of the plain one."""
        return problem.fact(self, lambda: call_part(self.reduced, problem, LinearFit))

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate without constraints; for a deficient rank a note names the parameters that are tied together."""
        return self.rows(problem).estimate(problem)


class SampledEstimator(LinearEstimator):
    """Base of those that need all samples; searches take least squares in their place."""

    needs_samples: ClassVar[bool] = True

    def quick(self) -> LeastSquares:
        """Return least squares with one weight for each joint."""
        return LeastSquares(weights="per_joint")


def _rank_notes(rank: Rank, names: tuple[str, ...]) -> tuple[Note, ...]:
    if not rank.groups:
        return ()
    lone = tuple(names[group[0]] for group in rank.groups if len(group) == 1)
    tied = tuple(tuple(names[k] for k in group) for group in rank.groups if len(group) > 1)
    return (RankDeficient(rank.rank, len(names), lone, tied),)


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
    current = np.ones(n)
    if weights == "equal":
        return current
    floor = rounding_floor(triangular)
    # the weights follow from the residual of the fit with the previous weights, starting from equal ones
    for _ in range(iterations):
        theta = solve_least_squares(*weight_joints(triangular, current, parameters, tolerance)).value
        deviation = np.sqrt(triangular.residual(theta) / np.maximum(triangular.rows, 1))
        previous, current = current, 1.0 / np.maximum(deviation, floor)
        if np.allclose(current, previous, rtol=0.01, atol=0.0):
            break
    return current


def rounding_floor(triangular: TriangularFactors) -> Array:
    """Return for each joint (n) the deviation below which a residual is rounding, and must not outweigh all others."""
    size = np.sqrt(np.square(triangular.factors[:, :, -1]).sum(axis=1) / np.maximum(triangular.rows, 1))
    return np.asarray(ROUNDING * np.where(size > 0, size, size.max(initial=0.0) or 1.0))


def weight_joints(
    triangular: TriangularFactors,
    weights: Array,
    parameters: Sequence[Parameter] = (),
    tolerance: float | None = None,
    unwhitened_rank: Rank | None = None,
) -> tuple[Array, Rank]:
    """Return the factor of the rows, multiplied by the ``weights`` (n) of their joints, and its rank.

    What the motion excites does not depend on the weights: the directions are those without weights, or those of
    ``unwhitened_rank`` where the rows are whitened.
    """
    if unwhitened_rank is not None:
        factor = triangular.stack(weights)
        return factor, rank_of(factor, parameters, tolerance, unwhitened_rank)
    # searches call this at each step of the weights: keep the factor and rank without weights
    key = tuple(parameters), tolerance
    if key not in triangular.cache:
        plain = triangular.stack()
        triangular.cache[key] = plain, rank_of(plain, parameters, tolerance)
    plain, rank = triangular.cache[key]
    if (weights == 1.0).all():
        return plain, rank
    factor = triangular.stack(weights)
    # weights that are all equal scale the factor, and leave its rank as it is
    return factor, rank_of(factor, parameters, tolerance, None if np.ptp(weights) == 0 else rank)


@dataclass(frozen=True)
class LeastSquares(LinearEstimator):
    """Ordinary least squares, theta = (X' X)^-1 X' y, eq. (11); with ``weights`` "per_joint" weighted by joint.

    The rank is that of ``rank_of`` with ``tolerance`` (None: the precision of the model). The covariance is
    s^2 (X' X)^-1 with s^2 the residual variance: it holds for independent errors of equal variance and an exactly known
    regressor; with correlated residuals it is too small. Calling it with a ``Problem`` gives an ``Estimate``.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=dy.LeastSquares())
    >>> for name, value, std in zip(arm.names, found.estimate.value, found.estimate.std):
    ...     print(f"{name} = {value:.4f} +- {std:.5f}")
    J = 0.0824 +- 0.00007
    h = 0.2498 +- 0.00022
    """

    tolerance: Annotated[float, Gt(0), Le(MAX_RANK_TOLERANCE)] | None = None
    weights: Weights = "equal"
    iterations: Annotated[int, Ge(1), Le(MAX_ITERATIONS)] = 3

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the rows with the weights of their joints."""
        triangular, parameters = problem.regression.triangular_factors, problem.model.parameters
        weights = joint_weights(triangular, self.weights, self.iterations, parameters, self.tolerance)
        factor, rank = weight_joints(triangular, weights, parameters, self.tolerance)
        return LinearFit(factor, rank, triangular.total, None if self.weights == "equal" else weights)

    def __str__(self) -> str:
        name = "least squares" + ", weighted by joint" * (self.weights == "per_joint")
        return settings_text(name, self, ("weights",))


def rows_by_joint(problem: Problem) -> LinearFit:
    """Return the rows of a problem, each joint weighted by its residual."""
    return LeastSquares(weights="per_joint").reduced(problem)
