"""What an estimator that is linear in the parameters has made of its rows, and the estimate that follows from it.

Least squares differ in how they weight their rows; what follows is the same for all: min |X theta - y| by a triangular
factor, and its covariance. A fit with constraints takes the same factor, so that each of them can be made consistent
with physics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, brief
from dynident.estimators.estimator import Determined, Estimate, Problem, Residual
from dynident.estimators.notes import RankDeficient
from dynident.regression import Rank, Whitening, rank_of

__all__ = ["IsLinear", "LeastSquaresSolution", "LinearFit", "estimate_of", "of_information", "solve"]

Array = NDArray[np.float64]


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


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Weighted rows [X | y] of a problem, reduced: the triangular ``factor`` (p + 1, p + 1) of ``total`` rows.

    ``directions`` are those of the parameters that they determine. How they were weighted, as in a ``Residual``:
    ``weights`` (n), ``sample_weights`` (N, n) of each motion with their ``slopes``, and ``whitening``. Where errors of
    the motion count in the fit, ``information`` (p, p) is that of all; with residuals that are ``correlated`` it
    allows for that. ``sigma`` (n) is the standard deviation of each joint's residual where that is not its rms.
    Where a prior draws it, ``plain`` is the fit without: what the prior moves that by may be an error. ``notes`` say
    what was not as it should be.
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

    __repr__ = brief

    @property
    def solution(self) -> LeastSquaresSolution:
        """The solution without constraints."""
        return solve(self.factor, self.directions)

    @property
    def variance(self) -> float:
        """The variance of the weighted residual."""
        return self.solution.rss / max(self.total - self.directions.rank, 1)

    @property
    def covariance(self) -> Array:
        """The covariance (p, p) of the solution without constraints and without a prior."""
        return self.directions.covariance(self.variance) if self.plain is None else self.plain.covariance

    def residual(self, problem: Problem, value: Array) -> Residual:
        """Return what ``value`` (p) leaves of the torque of a problem."""
        triangular = problem.regression.triangular_factors
        rms = np.sqrt(triangular.residual(value) / np.maximum(triangular.rows - 1, 1))
        how = self.weights, self.sample_weights, self.slopes
        sigma = rms if self.sigma is None else self.sigma
        return Residual(sigma, triangular.samples, *how, whitening=self.whitening, correlated=self.correlated)


@runtime_checkable
class IsLinear(Protocol):
    """An estimator that is linear in the parameters."""

    def reduced(self, problem: Problem) -> LinearFit:
        """Return what the estimator makes of the rows of the problem."""


def estimate_of(problem: Problem, fit: LinearFit) -> Estimate:
    """Return the estimate without constraints, (X' X)^-1 X' y, and s^2 (X' X)^-1, eq. (11)."""
    found, parameters = fit.solution, problem.model.parameters
    return Estimate(
        parameters=parameters,
        value=found.value,
        covariance=fit.covariance,
        determined=Determined(found.rank, found.condition, fit.directions),
        residual=fit.residual(problem, found.value),
        notes=(*_notes(fit.directions, problem.model.names), *fit.notes),
        information=fit.information,
    )


def of_information(
    value: Array, information: Array, directions: Rank, total: int, notes: tuple[Note, ...]
) -> LinearFit:
    """Return the fit of which ``value`` (p) is the solution and ``information`` (p, p) the inverse covariance.

    ``directions`` are those that the data determine, such as the rank of the regressor, ``total`` the number of rows
    behind them. For estimators that are linear but no least squares of rows, such as instrumental variables.
    """
    rank = directions.within(information)
    p, r = len(value), rank.rank
    factor = np.zeros((p + 1, p + 1))
    factor[:r, :p] = rank.values[:r, None] * rank.vectors[:, :r].T * rank.scale
    factor[:p, p] = factor[:p, :p] @ value
    factor[p, p] = np.sqrt(max(total - r, 1))  # so that the variance of a row is one
    own = Rank(r, rank.scale, rank.values, np.eye(p), rank.vectors, rank.tolerance, rank.unweighted)
    return LinearFit(factor, own, total, information=information, notes=notes)


def _notes(rank: Rank, names: tuple[str, ...]) -> tuple[Note, ...]:
    if not rank.groups:
        return ()
    lone = tuple(names[group[0]] for group in rank.groups if len(group) == 1)
    tied = tuple(tuple(names[k] for k in group) for group in rank.groups if len(group) > 1)
    return (RankDeficient(rank.rank, len(names), lone, tied),)
