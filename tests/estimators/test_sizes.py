"""Sizes of bodies that a robot file does not say: within an order of magnitude, whatever the size of the arm."""

from __future__ import annotations

import re

import numpy as np
import pytest

from dynident.estimators import bodies_of, estimate_sizes
from dynident.models import Model, RigidBodies
from dynident.motion.log import Motion
from dynident.regression import Regression
from tests.estimators.arms import arm, problem


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


def test_a_nominal_size_is_kept_unless_the_torques_contradict_it() -> None:
    text = arm()
    posed = problem(text)
    bodies = bodies_of(posed.model.parameters)
    kept = estimate_sizes(bodies, posed.model.parameters, posed.regression.triangular_factors)
    assert all(one is other for one, other in zip(kept, bodies, strict=True))
    toy = problem(re.sub(r"<mass value='?\"?[^/]*/>", '<mass value="1e-6"/>', text))
    other = estimate_sizes(bodies_of(toy.model.parameters), toy.model.parameters, toy.regression.triangular_factors)
    assert min(one.size[3] for one in other) > 1.0


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
    q, dq, ddq = (one[:, None] for one in states)
    motion = Motion(t, q, dq, ddq, 5.0 * ddq, ("j",), np.ones(500, dtype=bool))
    factors = Regression(model, (motion,)).triangular_factors
    (found,) = estimate_sizes(bodies_of(model.parameters), model.parameters, factors)
    assert found.size[3] ** 2 == pytest.approx(5.0, rel=1e-6)


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
