"""Ordinary least squares, eq. (11), from a triangular factor, with its covariance and an honest rank."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Lt
from numpy.typing import NDArray

from dynident.diagnostics import Note
from dynident.errors import ConfigError, choices
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.notes import RankDeficient
from dynident.regression import Compressed

__all__ = ["Fit", "LeastSquares", "Weights", "check_weights", "joint_weights", "solve"]

Array = NDArray[np.float64]
Weights = Literal["equal", "per_joint"]
ROUNDING = 1e-15  # a column this small beside the largest is rounding error


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares solution: ``value`` (p) (of least norm in scaled columns where the rank is deficient).

    ``inverse`` (p, p) = (X' X)^-1 on the determined subspace; ``rss`` the sum of squared residuals; ``groups`` the
    indices of parameters that cannot be told apart, one tuple for each independent group, empty at full rank.
    """

    value: Array
    inverse: Array
    rss: float
    rank: int
    condition: float
    groups: tuple[tuple[int, ...], ...]

    @property
    def undetermined(self) -> Array:
        """Indices of the parameters in any of the groups."""
        return np.array(sorted({k for group in self.groups for k in group}), dtype=int)


def solve(factor: Array, tolerance: float = 1e-12) -> Fit:
    """Solve min |X theta - y| from the R factor (p + 1, p + 1) of [X | y].

    The columns are scaled to norm one, but for those below 1e-15 of the largest, which are rounding error and count as
    zero; singular values below ``tolerance`` times the largest count as zero.
    ``condition`` is the ratio of the largest to the smallest of all singular values (inf where one is zero).
    """
    p = len(factor) - 1
    scale = np.linalg.norm(factor[:, :p], axis=0)
    empty = scale <= ROUNDING * scale.max()
    scale[empty] = 1.0
    R, y = np.where(empty, 0.0, factor[:p, :p]) / scale, factor[:p, p]
    U, s, Vt = np.linalg.svd(R)
    rank = int((s > tolerance * s[0]).sum()) if s[0] > 0 else 0
    V, kept = np.where(empty, 0.0, Vt[:rank]).T, s[:rank]  # a zero column has no share in any direction
    value = np.linalg.solve(R, y) if rank == p else V @ ((U[:, :rank].T @ y) / kept)
    half = V / kept / scale[:, None]
    rest = float(np.sum((y - R @ value) ** 2)) + float(factor[p, p] ** 2)
    with np.errstate(over="ignore"):
        condition = float(s[0] / s[-1]) if s[-1] > 0 else np.inf
    return Fit(value / scale, half @ half.T, rest, rank, condition, _groups(Vt[rank:]))


def _groups(null: Array) -> tuple[tuple[int, ...], ...]:
    """Return the sets of columns that a null space (k, p) ties together: the components of its projector's graph."""
    if not len(null):
        return ()
    from scipy.sparse.csgraph import connected_components

    tied = np.abs(null.T @ null) > 1e-6
    _, label = connected_components(tied, directed=False)
    involved = tied.any(axis=1)
    return tuple(tuple(np.flatnonzero(label == one).tolist()) for one in sorted(set(label[involved])))


def joint_weights(compressed: Compressed, weights: Weights, iterations: int, tolerance: float = 1e-12) -> Array:
    """Return the weight (n) of each joint: one, or with "per_joint" one over the standard deviation of its residual.

    The deviations are those of the fit with the previous weights, from equal ones on, until they change by less than
    1 % or ``iterations`` are done: feasible generalised least squares, Gautier and Poignet (2001).
    """
    n = len(compressed.factors)
    found = np.ones(n)
    if weights == "equal":
        return found
    size = np.sqrt(np.square(compressed.factors[:, :, -1]).sum(axis=1) / np.maximum(compressed.rows, 1))
    # a joint that the model explains to rounding must not outweigh all others
    floor = 1e-7 * np.where(size > 0, size, size.max(initial=0.0) or 1.0)
    for _ in range(iterations):
        theta = solve(compressed.stacked(found), tolerance).value
        deviation = np.sqrt(compressed.residual(theta) / np.maximum(compressed.rows, 1))
        previous, found = found, 1.0 / np.maximum(deviation, floor)
        if np.allclose(found, previous, rtol=0.01, atol=0.0):
            break
    return found


def check_weights(weights: str, iterations: int) -> None:
    """Raise ConfigError unless the settings of ``joint_weights`` can be used."""
    if weights not in get_args(Weights):
        raise ConfigError(f"weights = {weights!r} of the joints; {choices(weights, get_args(Weights))}")
    if iterations < 1:
        raise ConfigError(f"iterations = {iterations} of the weights; give a whole number from 1.")


@dataclass(frozen=True)
class LeastSquares:
    """theta = (X' X)^-1 X' y, eq. (11), all joints weighing the same, or with ``weights`` "per_joint" as their noise.

    ``tolerance``: relative to the largest singular value of the column-scaled regressor, below which a direction counts
    as not excited. The covariance is s^2 (X' X)^-1 with s^2 the residual variance: it holds for independent errors
    of equal variance and an exactly known regressor; correlated residuals make it too small.
    """

    tolerance: Annotated[float, Gt(0), Lt(1)] = 1e-12
    weights: Weights = "equal"
    iterations: Annotated[int, Ge(1)] = 3

    def __post_init__(self) -> None:
        check_weights(self.weights, self.iterations)
        if not 0 < self.tolerance < 1:
            raise ConfigError(
                f"tolerance of the rank is {self.tolerance}; give a number between 0 and 1, such as 1e-12."
            )

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; where the rank is deficient a note names the parameters that cannot be told apart."""
        compressed, model = problem.regression.compressed, problem.model
        weights = joint_weights(compressed, self.weights, self.iterations, self.tolerance)
        fit = solve(compressed.stacked(weights), self.tolerance)
        covariance = fit.inverse * (fit.rss / max(compressed.total - fit.rank, 1))
        for k in fit.undetermined:
            covariance[k, :] = covariance[:, k] = 0.0
            covariance[k, k] = np.inf
        return Estimate(
            value=fit.value,
            covariance=covariance,
            names=model.names,
            units=tuple(parameter.unit for parameter in model.parameters),
            sigma=np.sqrt(compressed.residual(fit.value) / np.maximum(compressed.rows - 1, 1)),
            rank=fit.rank,
            condition=fit.condition,
            samples=compressed.samples,
            notes=_notes(fit, model.names),
            weights=None if self.weights == "equal" else weights,
        )


def _notes(fit: Fit, names: tuple[str, ...]) -> tuple[Note, ...]:
    if not fit.groups:
        return ()
    lone = tuple(names[group[0]] for group in fit.groups if len(group) == 1)
    tied = tuple(tuple(names[k] for k in group) for group in fit.groups if len(group) > 1)
    return (RankDeficient(fit.rank, len(names), lone, tied),)
