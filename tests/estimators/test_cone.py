"""The feasible point nearest to another, and limits of a centre of mass."""

import numpy as np
import pytest

from dynident.estimators import BodyConstraint, centre_of_mass_limit
from dynident.estimators.cone import nearest_feasible
from dynident.runtime import ConfigError, ModelError

HESSIAN = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 4.0]])


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
