"""What physics demands of a model: one description for every method that keeps to it."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.estimators import (
    Constraints,
    PsdConstraint,
    bodies_of,
    interval_limit,
    mass_constraints,
    physical_constraints,
)
from dynident.models import INERTIAL, Parameter
from dynident.models.lagrangian import two_link_arm
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


def test_sides_of_limits_are_numbers_that_must_be_positive() -> None:
    """Open sides give none; equalities are left to whoever can hold them."""
    parameters = two_link_arm().parameters
    limit = interval_limit("bounds", parameters, {0: (1.0, 3.0), 1: (None, 2.0), 2: (4.0, 4.0)})
    theta = np.arange(1.0, 1.0 + len(parameters))
    found = Constraints((limit,)).scalar_constraints(theta, np.eye(len(theta))[:, :2])
    moved = [float(one.at(np.array([0.5, -1.0]))[0, 0, 0]) for one in found]
    assert moved == pytest.approx([0.5, 1.5, 1.0])  # 1.5 - 1, 3 - 1.5, 2 - 1
    assert all(
        name in one.label for name, one in zip((parameters[0].name,) * 2 + (parameters[1].name,), found, strict=True)
    )


def test_psd_constraints_of_bodies_hold_the_margin() -> None:
    model = single(None)
    found = Constraints(bodies=physical_constraints(model, np.zeros((1, 1))).bodies, margin=0.1)
    theta = random_body(np.random.default_rng(1))
    (one,) = found.psd_constraints(theta, np.eye(len(theta)))
    assert isinstance(one, PsdConstraint)
    np.testing.assert_allclose(one.constant[0], found.bodies[0].scaled_inertia(theta) - 0.1 * np.eye(4))
    assert float(np.linalg.eigvalsh(one.constant)[0, 0]) == pytest.approx(-found.violation(theta))


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
