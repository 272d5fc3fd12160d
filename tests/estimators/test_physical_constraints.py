"""What physics demands of a model, and the sizes of bodies that a robot file does not say."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.estimators import bodies_of, estimate_sizes, mass_constraints, physical_constraints
from dynident.models import INERTIAL, Parameter
from dynident.models.lagrangian import two_link_arm
from tests.estimators.arms import arm, problem
from tests.estimators.welded import random_body, single

POSES = np.random.default_rng(0).uniform(-3, 3, (16, 2))


def test_bodies_and_signs() -> None:
    model = single(None, ("viscous", 3), ("rotor", 3))
    found = physical_constraints(model, np.zeros((1, len(model.joints))))
    theta = np.append(random_body(np.random.default_rng(1)), [0.1, 0.2])
    assert [body.name for body in found.bodies] == ["b1"]
    assert found.matrices == ()
    assert [limit.family for limit in found.limits if len(limit.rows)] == ["viscous friction", "rotor inertia"]
    assert found.violation(theta) <= 0
    for k, value in ((0, -1.0), (10, -0.1), (11, -0.3)):
        broken = theta.copy()
        broken[k] = value
        assert found.violation(broken) > 0, model.names[k]


def test_a_model_without_bodies_has_a_mass_matrix() -> None:
    arm = two_link_arm()
    found = physical_constraints(arm, POSES)
    assert found.bodies == ()
    assert found.violation(np.asarray(arm.values)) <= 0
    turned = np.asarray(arm.values) * np.where(np.arange(len(arm.names)) == 0, -1, 1)
    worst = max(-np.linalg.eigvalsh(arm.mass_matrix(POSES, turned)).min(), 0.0)
    assert worst > 0
    assert found.violation(turned) == pytest.approx(worst)
    assert found.select_family("viscous friction").matrices == ()
    bodies = mass_constraints(single(None), np.zeros((1, 6)))
    assert (bodies.bodies, len(bodies.matrices)) == ((), 1)


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
    parameters = posed.model.parameters
    found = estimate_sizes(bodies_of(parameters), parameters, posed.regression.triangular_factors)
    for one, other in zip(found, truth, strict=True):
        mass_ratio, length_ratio = (one.size[3] / other.size[3]) ** 2, one.size[0] / one.size[3]
        assert 0.3 < mass_ratio < 30
        assert 0.3 < length_ratio / (other.size[0] / other.size[3]) < 5


def test_what_no_joint_moves_has_no_size_of_its_own() -> None:
    posed = problem(arm(inertias="none"))
    bodies, factors = bodies_of(posed.model.parameters), posed.regression.triangular_factors
    unmoved = factors.factors.copy()
    unmoved[:, :, bodies[0].columns] = 0.0
    found = estimate_sizes(bodies, posed.model.parameters, type(factors)(unmoved, factors.rows))
    assert all(np.isfinite(one.size).all() for one in found)
    alone = factors.factors.copy()
    alone[1:, :, -1] = 0.0  # only the first joint has a torque, and nothing acts on it
    alone[0, :, :-1] = 0.0
    found = estimate_sizes(bodies, posed.model.parameters, type(factors)(alone, factors.rows))
    assert all(one is other for one, other in zip(found, bodies, strict=True))
