"""Conic programs against optima known by hand, and what is said of those that have none."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.estimators import BodyConstraint, Constraints, centre_of_mass_limit, interval_limit
from dynident.estimators.cone import minimise, nearest_feasible
from dynident.models import Parameter
from dynident.runtime import ConfigError, ModelError

XYZ = tuple(Parameter(name, "") for name in "xyz")
HESSIAN = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 4.0]])
COST = np.array([-1.0, -2.0, 8.0])
ZERO, WHOLE = np.zeros(3), np.eye(3)


def test_limits_hold_where_they_act_and_only_there() -> None:
    """x >= 1, y = 0.5, z <= 5: the first two act, and z is free at -2."""
    limit = interval_limit("bounds", XYZ, {0: (1.0, None), 1: (0.5, 0.5), 2: (None, 5.0)})
    minimum = minimise(HESSIAN, COST, Constraints((limit,)), ZERO, WHOLE)
    np.testing.assert_allclose(minimum.point, [1.0, 0.5, -2.0], atol=1e-6)
    assert minimum.is_optimal
    assert minimum.stationarity < 1e-7
    assert minimum.gap < 1e-7
    shifted = minimise(HESSIAN, COST, Constraints((limit,)), np.array([-2.0, 0.5, 1.0]), np.diag([2.0, 1.0, 1.0]))
    np.testing.assert_allclose(shifted.point[:2], [1.5, 0.0], atol=1e-6)


def test_the_nearest_feasible_point_keeps_the_slack() -> None:
    """The eigenvalue that is negative is lifted to the slack, the others stay."""
    slopes = np.zeros((1, 2, 2, 3))
    slopes[0, 0, 0, 0] = slopes[0, 1, 1, 1] = 1.0
    result = nearest_feasible(np.array([2.0, -1.0, 7.0]), HESSIAN * np.eye(3), [slopes], [0.25])
    np.testing.assert_allclose(result, [2.0, 0.25, 7.0], atol=1e-5)
    never = np.zeros((1, 1, 1, 3))
    with pytest.raises(ModelError, match="no parameters are physical"):
        nearest_feasible(np.ones(3), np.eye(3), [slopes, never], [0.0, 0.5])


def body(name: str, first: int) -> BodyConstraint:
    return BodyConstraint(name, np.arange(first, first + 10), np.ones(4))


def test_a_centre_of_mass_lies_in_its_box() -> None:
    limit = centre_of_mass_limit(
        "centre", (body("a", 0), body("b", 10)), 20, {"b": ((-0.1, -0.2, 0.3), (0.4, 0.5, 0.6))}
    )
    theta = np.zeros(20)
    theta[10:14] = 2.0, *(2.0 * np.array([0.1, 0.2, 0.5]))
    np.testing.assert_allclose(limit.rows @ theta / 2.0, [0.2, 0.4, 0.2, 0.3, 0.3, 0.1])
    assert limit.violation(theta) <= 0
    theta[13] = 2.0 * 0.61
    assert limit.violation(theta) == pytest.approx(2.0 * 0.01)
    assert limit.labels[0] == "centre of mass of b from -0.1 m along x"
    assert limit.labels[-1] == "centre of mass of b to 0.6 m along z"
    with pytest.raises(ConfigError, match="no body 'c' with ten inertial parameters"):
        centre_of_mass_limit("centre", (body("a", 0),), 10, {"c": ((0, 0, 0), (1, 1, 1))})
