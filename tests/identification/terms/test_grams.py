"""Trials from Gram matrices are those of least squares on the rows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.identification.terms.grams import (
    CandidateGrams,
    Folds,
    JointGrams,
    eliminate_columns,
    transfer_gains,
    try_groups,
)

Array = NDArray[np.float64]
F, N = 4, 400


def problem() -> tuple[Array, Array, JointGrams]:
    """Columns (N, 6) and a torque of which the third and fifth explain some, with their Gram matrices by block."""
    rng = np.random.default_rng(3)
    X = rng.normal(size=(N, 6))
    y = X @ np.array([1.0, -2.0, 0.5, 0.0, 0.8, 0.0]) + 0.1 * rng.normal(size=N)
    rows = np.column_stack([X, y]).reshape(F, N // F, 7)
    return X, y, JointGrams.of(np.swapaxes(rows, 1, 2), (F, 1), np.eye(2))


def folds() -> Folds:
    eye = np.eye(F)[:, :, None]
    return Folds(1.0 - eye, eye, np.arange(F))


def error(X: Array, y: Array, fold: int) -> float:
    block = np.arange(N) * F // N
    value = np.linalg.lstsq(X[block != fold], y[block != fold], rcond=None)[0]
    return float(np.sum((y - X @ value)[block == fold] ** 2))


NONE = (np.zeros((F, 2, 2)), np.zeros((F, 2)))


def test_errors_are_those_of_least_squares_on_the_rows() -> None:
    X, y, grams = problem()
    groups = try_groups(CandidateGrams(grams, NONE, 3.0), folds(), [0], [[[1]], [[2]], [[1, 2]], [[1], [2]]])
    for fold in range(F):
        assert groups.before[fold] == pytest.approx(error(X[:, [0, 1, 2]], y, fold), rel=1e-5)
        expected = [error(X[:, [0, 1, 2, *more]], y, fold) for more in ([3], [4], [3, 4], [4])]
        assert groups.after[fold] == pytest.approx(expected, rel=1e-5)
    assert (groups.best[:, 3] == 1).all()
    assert groups.values[1] == pytest.approx(np.full((F, 1), 0.8), abs=0.05)
    assert groups.independent.all()


def test_columns_with_known_coefficients_are_judged_beside_a_fit_of_all_else() -> None:
    X, y, grams = problem()
    reference = np.array([[0.8], [0.5], [0.0], [-1.0]])  # of column 4, whose true coefficient is 0.8
    gains, before = transfer_gains(CandidateGrams(grams, NONE, 2.0), folds(), folds().test, [0], ([[2]] * F, reference))
    for fold in range(F):
        other = y - X[:, 4] * reference[fold]
        assert before[fold] == pytest.approx(error(X[:, [0, 1, 2]], y, fold), rel=1e-5)
        assert before[fold] - gains[fold] == pytest.approx(error(X[:, [0, 1, 2]], other, fold), rel=1e-5)
    assert gains[0] > gains[1] > gains[2] == pytest.approx(0.0, abs=1e-9)
    assert gains[3] < 0


def test_others_count_as_rows() -> None:
    X, y, grams = problem()
    more = np.random.default_rng(0).normal(size=(50, 3)) @ np.diag([10.0, 10.0, 1.0])
    rest = np.tile(more[:, :2].T @ more[:, :2], (F, 1, 1)), np.tile(more[:, :2].T @ more[:, 2], (F, 1))
    groups = try_groups(CandidateGrams(grams, rest, 1.0), folds(), [0, 1, 2], [[[3]]])
    block, wide = np.arange(N) * F // N, np.zeros((50, 6))
    wide[:, :2] = more[:, :2]
    for fold in range(F):
        rows, right = np.concatenate([X[block != fold], wide]), np.concatenate([y[block != fold], more[:, 2]])
        value = np.linalg.lstsq(rows, right, rcond=None)[0]
        assert groups.after[fold, 0] == pytest.approx(np.sum((y - X @ value)[block == fold] ** 2), rel=1e-5)


def test_a_dependent_column_is_not_seen() -> None:
    X, y, _ = problem()
    rows = np.column_stack([X[:, :3], X[:, 1] - X[:, 2], y]).reshape(F, N // F, 5)
    grams = JointGrams.of(np.swapaxes(rows, 1, 2), (F, 1), np.eye(2))
    groups = try_groups(CandidateGrams(grams, NONE, 1.0), folds(), [0], [[[1]]])
    assert not groups.independent.any()


def test_elimination_leaves_the_normal_matrix_of_the_rest() -> None:
    X, y, _ = problem()
    rows = np.column_stack([X, y])
    M, right = eliminate_columns(rows.T @ rows, 4, [4, 5])
    assert np.linalg.solve(M, right) == pytest.approx(np.linalg.lstsq(X, y, rcond=None)[0][:4], rel=1e-6)
