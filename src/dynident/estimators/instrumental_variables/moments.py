"""The equations W' D^2 (y - X theta) = 0 of instruments W and weights D, streamed, and their solution.

X and W are taken in directions of the parameters in which the weighted X is orthonormal: no digits are lost when it is
multiplied, and nothing is inverted that the data do not determine. Reference: Janot, Vandanjon and Gautier (2014).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.regression import Rank, Regression

__all__ = ["Block", "Moments", "Strength", "blocks_of", "cholesky", "moments_of"]

Array = NDArray[np.float64]
LEAST, NOTHING = 1e-14, 1e-10  # of the torque: a residual below is rounding; of a weighted row without any torque
INDEPENDENT = 1e-9  # relative singular value of W' X below which a direction has no instrument


@dataclass(frozen=True, eq=False)
class Strength:
    """How much of the regressor the instruments explain where they explain least: the smallest canonical
    ``correlation`` r, the F ``statistic`` N r^2 / (1 - r^2) of the first stage, and the ``direction`` (p)."""

    correlation: float
    statistic: float
    direction: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Moments:
    """Cross products of rows and instruments by joint, in the r columns of ``turn`` (p, r).

    ``crossed`` = W_j' X_j, ``instruments`` = W_j' W_j and ``regressors`` = X_j' X_j (n, r, r); ``torque`` = W_j' y_j
    (n, r); ``square`` (n) = y_j' y_j and ``pulled`` (n, r) = X_j' y_j, from ``rows`` (n) of each joint, whose
    ``weights`` (n) are those in D.
    """

    turn: Array
    weights: Array
    crossed: Array
    instruments: Array
    regressors: Array
    torque: Array
    pulled: Array
    square: Array
    rows: NDArray[np.int_]

    __repr__ = brief

    def total(self, each: Array) -> Array:
        """Return sum_j w_j^2 times what there is of each joint."""
        return np.asarray(np.tensordot(self.weights**2, each, axes=1))

    @property
    def value(self) -> Array:
        """theta (p) = turn (W' D^2 X)^-1 W' D^2 y; without a share of directions that have no instrument."""
        solution = np.linalg.lstsq(self.total(self.crossed), self.total(self.torque), rcond=INDEPENDENT)[0]
        return np.asarray(self.turn @ solution, dtype=np.float64)

    def to_turn(self, value: Array) -> Array:
        """Return beta (r) with turn beta = ``value`` (p)."""
        return np.asarray(np.linalg.lstsq(self.turn, value, rcond=None)[0])

    def white(self, beta: Array) -> Array:
        """Return the covariance (r, r) of W' D^2 e for residuals e at beta (r) that are white."""
        return np.asarray(np.tensordot(self.weights**4 * self.residual(beta), self.instruments, axes=1))

    def distance(self, one: Array, other: Array) -> float:
        """Return how far two values (p) are apart: usual standard errors of a direction where residuals are white."""
        beta, step = self.to_turn(one), self.to_turn(one - other)
        errors = np.linalg.solve(cholesky(self.white(beta)), self.total(self.crossed) @ step)
        return float(np.sqrt(np.mean(np.square(errors))))

    def change(self, one: Array, other: Array) -> float:
        """Return how much two values (p) differ in the torque, relative to that of the one."""
        size = float(np.linalg.norm(self.to_turn(one)))
        return float(np.linalg.norm(self.to_turn(one - other))) / size if size else 0.0

    def residual(self, beta: Array) -> Array:
        """Return the mean squared residual (n) of each joint at beta (r), not below rounding of the torque."""
        left = self.square - 2 * self.pulled @ beta + np.einsum("i,jik,k->j", beta, self.regressors, beta)
        least = np.where(self.square > 0, LEAST**2 * self.square, (NOTHING / self.weights) ** 2)
        return np.asarray(np.maximum(left, least) / np.maximum(self.rows, 1))

    def strength(self, samples: float) -> Strength:
        """Return the strength of the instruments, of so many independent samples."""
        left, right = (cholesky(self.total(one)) for one in (self.instruments, self.regressors))
        _, size, axes = np.linalg.svd(np.linalg.solve(left, np.linalg.solve(right, self.total(self.crossed).T).T))
        least = float(np.clip(size[-1], 0.0, 1.0))
        direction = self.turn @ np.linalg.solve(right.T, axes[-1])
        return Strength(least, samples * least**2 / max(1.0 - least**2, np.finfo(float).eps), direction)


def moments_of(rows: Regression, instruments: Regression, rank: Rank, weights: Array) -> Moments:
    """Return the moments of the ``rows`` with the regressor of other motions at the same samples, on the directions
    of ``rank``, that of the weighted rows; ``weights`` (n) of the joints. InputError where there are too few rows."""
    turn = rank.determined / rank.values[: rank.rank]
    n, r = len(weights), turn.shape[1]
    crossed, within, regressors = (np.zeros((n, r, r)) for _ in range(3))
    torque, pulled, square, count = np.zeros((n, r)), np.zeros((n, r)), np.zeros(n), np.zeros(n, dtype=int)
    for block in blocks_of(rows, instruments, turn):
        for j in range(n):
            x, w, y = block.X[:, j], block.W[:, j], block.y[:, j]
            crossed[j] += w.T @ x
            within[j] += w.T @ w
            regressors[j] += x.T @ x
            torque[j] += w.T @ y
            pulled[j] += x.T @ y
            square[j] += y @ y
        count += block.keep.sum(axis=0)
    if count.sum() <= r:
        raise InputError(
            f"{', '.join(motion.source for motion in rows.motions)}: {count.max()} samples have instruments, too few "
            f"for {r} parameters; record longer or, where these are lagged, smooth less or give a shorter `lag`."
        )
    return Moments(turn, weights, crossed, within, regressors, torque, pulled, square, count)


@dataclass(frozen=True, eq=False)
class Block:
    """Some samples ``rows`` of a recording: X and W (B, n, r), the torque ``y`` and whether to use it, ``keep`` (B, n);
    zero where it is not."""

    rows: slice
    X: Array
    W: Array
    y: Array
    keep: NDArray[np.bool_]

    __repr__ = brief


def blocks_of(rows: Regression, instruments: Regression, turn: Array) -> Iterator[Block]:
    """Yield the rows and their instruments in the columns of ``turn`` (p, r)."""
    pairs = zip(rows.placed(rows.model.structure), instruments.placed(rows.model.structure), strict=True)
    for (_, at, one), (_, _, other) in pairs:
        keep = np.ones(one.tau.T.shape, dtype=bool) if one.keep is None else one.keep.T
        X, W = (block.regressor(turn) * keep[:, :, None] for block in (one, other))
        yield Block(at, X, W, one.tau.T * keep, keep)


def cholesky(matrix: Array) -> Array:
    """Return the Cholesky factor (r, r), of a singular matrix that of one near to it."""
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    some = matrix / np.outer(scale, scale)
    return np.asarray(scale[:, None] * np.linalg.cholesky(some + 1e-13 * len(some) * np.eye(len(some))))
