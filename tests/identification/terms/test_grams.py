"""Trials from Gram matrices are those of least squares on the rows."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.identification.terms.grams import CandidateGrams, Folds, JointGrams, transfer_gains, try_groups

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
