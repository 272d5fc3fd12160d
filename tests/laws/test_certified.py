"""Least squares against the certified results of NIST's Statistical Reference Datasets (linear regression)."""

from collections.abc import Iterable, Sequence
from typing import Any

import mpmath
import numpy as np
import pytest

from dynident.estimators.least_squares import LeastSquaresSolution, solve_least_squares
from dynident.regression import RegressorBlock
from tests.laws.strd import PROBLEMS, Certified
from tests.regression.dense import triangularise

every_problem = pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)

# Correct digits of coefficients, standard errors and residual deviation; what double precision of the data leaves.
DIGITS = {
    "Longley": (10, 11, 11),
    "Wampler1": (9, 9, 9),
    "Wampler2": (12, 12, 12),
    "Wampler3": (9, 12, 13),
    "Wampler4": (8, 12, 13),
    "Wampler5": (6, 12, 13),
    "Filip": (6, 6, 7),
    "Pontius": (12, 11, 11),
    "NoInt1": (14, 14, 14),
    "NoInt2": (14, 14, 14),
}


def digits(entries: Iterable[Any], certified: Sequence[str], scale: float = 1.0) -> float:
    """Return the smallest number of correct digits (LRE), at most 15; where zero is certified, those of ``scale``."""
    smallest = mpmath.mpf(15)
    for value, text in zip(entries, certified, strict=True):
        true = mpmath.mpf(text)
        error = abs(mpmath.mpf(value) - true) / (abs(true) or scale)
        smallest = min(smallest, -mpmath.log10(error)) if error else smallest
    return float(smallest)


def streamed(problem: Certified) -> LeastSquaresSolution:
    rows = np.array_split(problem.X[:, None], 4), np.array_split(np.array(problem.y, float)[:, None], 4)
    blocks = (RegressorBlock(Y, tau) for Y, tau in zip(*rows, strict=True))
    return solve_least_squares(triangularise(blocks, 1, len(problem.coefficients)).stack())


@every_problem
def test_typed_data_and_certified_values_belong_together(problem: Certified) -> None:
    """In 60 digits, the least-squares solution of the data is the certified one to all published digits."""
    with mpmath.workdps(60):
        X = mpmath.matrix(problem.columns(mpmath.mpf)).T
        y = mpmath.matrix([mpmath.mpf(value) for value in problem.y])
        inverse = (X.T * X) ** -1
        b = inverse * X.T * y
        residual = mpmath.norm(y - X * b) / mpmath.sqrt(X.rows - X.cols)
        errors = [residual * mpmath.sqrt(inverse[k, k]) for k in range(X.cols)]
        assert digits(b, problem.coefficients) > 14
        assert digits(errors, problem.errors) > 14
        assert digits([residual], [problem.residual]) > 14


@every_problem
def test_streamed_least_squares_is_correct_to_the_stated_digits(problem: Certified) -> None:
    coefficients, errors, residual = DIGITS[problem.name]
    fit, y = streamed(problem), np.array(problem.y, float)
    deviation = np.sqrt(fit.rss / (len(y) - fit.directions.rank))
    scale = float(np.linalg.norm(y))
    assert digits(fit.value, problem.coefficients) >= coefficients
    assert digits(deviation * np.sqrt(np.diag(fit.directions.inverse)), problem.errors, scale) >= errors
    assert digits([deviation], [problem.residual], scale) >= residual
    assert (fit.directions.rank, fit.directions.groups) == (len(problem.coefficients), ())
    assert fit.directions.condition < 1e10


@every_problem
def test_streamed_least_squares_loses_no_digit_against_numpy(problem: Certified) -> None:
    """All rows at once, columns scaled: what numpy does with the same data."""
    X, y = problem.X, np.array(problem.y, float)
    scale = np.linalg.norm(X, axis=0)
    peer = np.linalg.lstsq(X / scale, y, rcond=1e-14)[0] / scale
    assert digits(streamed(problem).value, problem.coefficients) >= digits(peer, problem.coefficients) - 1
