"""What a linear estimator makes of its rows: the estimate that follows, with constraints and without."""

import numpy as np
import pytest

from dynident.estimators import LeastSquares, LinearEstimator, PhysicallyConsistent, estimate_of, fit_from_information
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.models.lagrangian import two_link_arm
from dynident.project.parts import build
from dynident.runtime import ConfigError
from dynident.runtime.families import ESTIMATORS
from dynident.testing.estimator import make_problem, multisine_motion

PROBLEM = make_problem(two_link_arm(), multisine_motion(two_link_arm(), noise=0.01))


def test_value_and_information_stand_for_rows() -> None:
    found, rows = LeastSquares()(PROBLEM), LeastSquares().reduced(PROBLEM)
    same = estimate_of(
        PROBLEM, fit_from_information(found.value, np.linalg.inv(found.covariance), rows.directions, rows.total, ())
    )
    np.testing.assert_allclose(same.value, found.value, rtol=1e-12)
    np.testing.assert_allclose(same.covariance, found.covariance, rtol=1e-9)


def test_of_directions_that_are_not_determined_nothing_is_said() -> None:
    rows = LeastSquares().reduced(PROBLEM)
    information = np.diag([1.0, 4.0, 0.0, 1.0, 1.0, 1.0, 1.0])
    fit = fit_from_information(np.arange(7.0), information, rows.directions, 100, ())
    found = estimate_of(PROBLEM, fit)
    assert found.determined.rank == 6
    assert np.isinf(found.std[2])
    np.testing.assert_allclose(np.delete(found.std, 2), [1.0, 0.5, 1.0, 1.0, 1.0, 1.0], rtol=1e-9)
    np.testing.assert_allclose(np.delete(found.value, 2), [0.0, 1.0, 3.0, 4.0, 5.0, 6.0], atol=1e-9)


def test_constraints_take_the_rows_of_a_linear_estimator() -> None:
    weighted = PhysicallyConsistent(fit=LeastSquares(weights="per_joint"))(PROBLEM)
    np.testing.assert_array_equal(weighted.value, PhysicallyConsistent()(PROBLEM).value)
    equal, own = PhysicallyConsistent(fit=LeastSquares()), PhysicallyConsistent(weights="equal")
    np.testing.assert_array_equal(equal(PROBLEM).covariance, own(PROBLEM).covariance)


def test_a_part_in_a_part_is_built_from_its_settings() -> None:
    settings = {"kind": "consistent", "fit": {"kind": "least_squares", "weights": "per_joint"}}
    made = build(ESTIMATORS, settings, "estimator")
    assert made == PhysicallyConsistent(fit=LeastSquares(weights="per_joint"))
    assert build(ESTIMATORS, ESTIMATORS.describe(made), "estimator") == made


def test_only_linear_estimators_have_such_rows() -> None:
    assert isinstance(LeastSquares(), LinearEstimator)
    with pytest.raises(ConfigError, match=r"fit = MaximumLikelihood\(\): is not linear in the parameters"):
        PhysicallyConsistent(fit=MaximumLikelihood())
    with pytest.raises(ConfigError, match="is not linear"):
        PhysicallyConsistent(fit=PhysicallyConsistent())
