"""What physics demands of a model, and the sizes of bodies that a robot file does not say."""

import numpy as np
import pytest

from dynident.estimators import bodies_of, estimate_sizes
from dynident.models import INERTIAL, Parameter
from tests.estimators.arms import arm, problem


@pytest.mark.parametrize(
    ("mass", "moments", "size"),
    [
        (4.0, (0.03, 0.02, 0.03), (0.2, 2.0)),  # sum 0.08: half of it is m r^2, r = 0.1 m; sqrt(m) r and sqrt(m)
        (4.0, (0.0, 0.0, 0.0), (0.1, 1.0)),
        (0.0, (0.03, 0.02, 0.03), (0.1, 1.0)),
        (4.0, (0.03, None, 0.03), (0.1, 1.0)),
    ],
)
def test_the_size_of_a_body_is_nominal_or_a_kilogram_of_a_decimetre(
    mass: float, moments: tuple[float | None, ...], size: tuple[float, float]
) -> None:
    x, y, z = moments
    nominal = (mass, 0.0, 0.0, 0.0, x, 0.0, y, 0.0, 0.0, z)
    parameters = [Parameter(role, "", "", value, role, "b") for role, value in zip(INERTIAL, nominal, strict=True)]
    (body,) = bodies_of(parameters)
    np.testing.assert_allclose(body.size, [size[0]] * 3 + [size[1]], rtol=1e-12)
    assert bodies_of(parameters[:-1]) == ()


@pytest.mark.parametrize(("mass", "length"), [(1.0, 1.0), (1e-2, 0.3), (1e-4, 0.05)])
def test_torques_and_lever_arms_tell_the_size_of_a_body(mass: float, length: float) -> None:
    truth = bodies_of(problem(arm(mass, length), mass, length).model.parameters)
    posed = problem(arm(mass, length, "none"), mass, length)
    sizes = estimate_sizes(posed.model.parameters, posed.regression.triangular_factors)
    for first, second in zip(sizes, truth, strict=True):
        mass_ratio, length_ratio = (first.size[3] / second.size[3]) ** 2, first.size[0] / first.size[3]
        assert 0.3 < mass_ratio < 30
        assert 0.3 < length_ratio / (second.size[0] / second.size[3]) < 5
