"""What physics demands of a model, and the sizes of bodies that a robot file does not say."""

from __future__ import annotations

import re

import numpy as np
import pytest

from dynident.estimators import (
    Constraints,
    PsdConstraint,
    bodies_of,
    estimate_sizes,
    interval_limit,
    mass_constraints,
    physical_constraints,
)
from dynident.models import INERTIAL, Model, Parameter, RigidBodies
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Motion
from dynident.regression import Regression
from tests.estimators.arms import arm, problem
from tests.estimators.welded import random_body, single

POSES = np.random.default_rng(0).uniform(-3, 3, (16, 2))


def test_bodies_and_signs() -> None:
    model = single(None, ("viscous", 3), ("rotor", 3))
    result = physical_constraints(model, np.zeros((1, len(model.joints))))
    theta = np.append(random_body(np.random.default_rng(1)), [0.1, 0.2])
    assert [body.name for body in result.bodies] == ["b1"]
    assert result.matrices == ()
    assert [limit.family for limit in result.limits if len(limit.rows)] == ["viscous friction", "rotor inertia"]
    assert result.violation(theta) <= 0
    for k, value in ((0, -1.0), (10, -0.1), (11, -0.3)):
        broken = theta.copy()
        broken[k] = value
        assert result.violation(broken) > 0, model.names[k]


def test_a_model_without_bodies_has_a_mass_matrix() -> None:
    arm = two_link_arm()
    result = physical_constraints(arm, POSES)
    assert result.bodies == ()
    assert result.violation(np.asarray(arm.values)) <= 0
    turned = np.asarray(arm.values) * np.where(np.arange(len(arm.names)) == 0, -1, 1)
    worst = max(-np.linalg.eigvalsh(arm.mass_matrix(POSES, turned)).min(), 0.0)
    assert worst > 0
    assert result.violation(turned) == pytest.approx(worst)
    assert result.select_family("viscous friction").matrices == ()
    bodies = mass_constraints(single(None), np.zeros((1, 6)))
    assert (bodies.bodies, len(bodies.matrices)) == ((), 1)


def test_sides_of_limits_are_numbers_that_must_be_positive() -> None:
    """Open sides give none; equalities are left to whoever can hold them."""
    parameters = two_link_arm().parameters
    limit = interval_limit("bounds", parameters, {0: (1.0, 3.0), 1: (None, 2.0), 2: (4.0, 4.0)})
    theta = np.arange(1.0, 1.0 + len(parameters))
    result = Constraints((limit,)).scalar_constraints(theta, np.eye(len(theta))[:, :2])
    moved = [float(x.at(np.array([0.5, -1.0]))[0, 0, 0]) for x in result]
    assert moved == pytest.approx([0.5, 1.5, 1.0])  # 1.5 - 1, 3 - 1.5, 2 - 1
    assert all(
        name in x.label for name, x in zip((parameters[0].name,) * 2 + (parameters[1].name,), result, strict=True)
    )


def test_psd_constraints_of_bodies_hold_the_margin() -> None:
    model = single(None)
    result = Constraints(bodies=physical_constraints(model, np.zeros((1, 1))).bodies, margin=0.1)
    theta = random_body(np.random.default_rng(1))
    (case,) = result.psd_constraints(theta, np.eye(len(theta)))
    assert isinstance(case, PsdConstraint)
    np.testing.assert_allclose(case.constant[0], result.bodies[0].scaled_inertia(theta) - 0.1 * np.eye(4))
    assert float(np.linalg.eigvalsh(case.constant)[0, 0]) == pytest.approx(-result.violation(theta))


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
    sizes = estimate_sizes(bodies_of(parameters), parameters, posed.regression.triangular_factors)
    for first, second in zip(sizes, truth, strict=True):
        mass_ratio, length_ratio = (first.size[3] / second.size[3]) ** 2, first.size[0] / first.size[3]
        assert 0.3 < mass_ratio < 30
        assert 0.3 < length_ratio / (second.size[0] / second.size[3]) < 5


def test_a_nominal_size_is_kept_unless_the_torques_contradict_it() -> None:
    text = arm()
    posed = problem(text)
    bodies = bodies_of(posed.model.parameters)
    kept = estimate_sizes(bodies, posed.model.parameters, posed.regression.triangular_factors)
    assert all(x is other for x, other in zip(kept, bodies, strict=True))
    toy = problem(re.sub(r"<mass value='?\"?[^/]*/>", '<mass value="1e-6"/>', text))
    other = estimate_sizes(bodies_of(toy.model.parameters), toy.model.parameters, toy.regression.triangular_factors)
    assert min(x.size[3] for x in other) > 1.0


def test_without_torque_or_effect_nothing_is_known() -> None:
    posed = problem(arm(inertias="none"))
    bodies, factors = bodies_of(posed.model.parameters), posed.regression.triangular_factors
    silent = type(factors)(np.zeros_like(factors.factors), factors.rows)
    assert estimate_sizes(bodies, posed.model.parameters, silent) == bodies
    assert estimate_sizes((), (), factors) == ()


def test_a_slider_has_its_mass_from_its_force() -> None:
    text = (
        '<robot name="slider"><link name="base"/><link name="cart"><inertial><mass value="0"/>'
        '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="prismatic">'
        '<parent link="base"/><child link="cart"/><axis xyz="1 0 0"/></joint></robot>'
    )
    model = Model((RigidBodies(text),))
    t = np.linspace(0.0, 5.0, 500)
    states = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    q, dq, ddq = (state[:, None] for state in states)
    motion = Motion(t, q, dq, ddq, 5.0 * ddq, ("j",), np.ones(500, dtype=bool))
    factors = Regression(model, (motion,)).triangular_factors
    (size,) = estimate_sizes(bodies_of(model.parameters), model.parameters, factors)
    assert size.size[3] ** 2 == pytest.approx(5.0, rel=1e-6)


def test_what_no_joint_moves_has_no_size_of_its_own() -> None:
    posed = problem(arm(inertias="none"))
    bodies, factors = bodies_of(posed.model.parameters), posed.regression.triangular_factors
    unmoved = factors.factors.copy()
    unmoved[:, :, bodies[0].columns] = 0.0
    sizes = estimate_sizes(bodies, posed.model.parameters, type(factors)(unmoved, factors.rows))
    assert all(np.isfinite(x.size).all() for x in sizes)
    alone = factors.factors.copy()
    alone[1:, :, -1] = 0.0  # only the first joint has a torque, and nothing acts on it
    alone[0, :, :-1] = 0.0
    sizes = estimate_sizes(bodies, posed.model.parameters, type(factors)(alone, factors.rows))
    assert all(x is other for x, other in zip(sizes, bodies, strict=True))
