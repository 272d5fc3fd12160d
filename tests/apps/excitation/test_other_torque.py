"""Pinocchio's torque is that of the model: of chains, trees, joints that slide, mimic or stand."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation.verify import pinocchio_torque
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.models.lagrangian import two_link_arm
from tests.robots import ARM, ARM_MJCF, GRIPPER, joint, link, urdf

RNG = np.random.default_rng(3)


@pytest.mark.parametrize(
    "bodies",
    [
        RigidBodies(ARM, source="arm"),
        RigidBodies(ARM, ("twist", "shoulder"), {"rail": 0.3}, (1.0, 2.0, -9.0), "arm"),
        RigidBodies(GRIPPER, source="gripper"),
        RigidBodies(urdf(link("a"), link("b", 1.0, (0.1, 0, 0)), joint("only", "continuous", "a", "b")), source="one"),
    ],
)
def test_the_two_routes_agree(bodies):
    model = Model((Viscous(bodies.joints), bodies, Coulomb(bodies.joints)))
    theta = RNG.normal(size=len(model.parameters))  # physical or not
    states = RNG.normal(size=(3, 20, len(model.joints)))
    other = pinocchio_torque(model, theta, *states)
    np.testing.assert_allclose(other, model.torque(*states, theta), atol=1e-9 * np.abs(other).max())


def test_rounded_angles_are_the_same_by_both():
    file = urdf(
        link("a"), link("b", 1.0, (0.1, 0, 0)), link("c", 2.0, (0, 0.2, 0)),
        joint("one", "revolute", "a", "b", (0, 0, 0.3), (1.5708, 0, -3.1416)),
        joint("two", "revolute", "b", "c", (0.3, 0, 0), (0, 0.785, 1.571)),
    )  # fmt: skip
    model = Model((RigidBodies(file, source="rounded"),))
    theta, states = RNG.normal(size=20), RNG.normal(size=(3, 20, 2))
    other = pinocchio_torque(model, theta, *states)
    np.testing.assert_allclose(other, model.torque(*states, theta), atol=1e-9 * np.abs(other).max())


def test_files_that_its_reader_refuses_are_checked_too():
    arm = ARM.replace('effort="10" ', "").replace('type="continuous"><parent', 'type="continuous"><dynamics/><parent')
    file = arm.replace("</inertial>", '</inertial><visual><geometry><mesh filename=""/></geometry></visual>')
    model = Model((RigidBodies(file, source="no effort"),))
    theta, states = RNG.normal(size=30), RNG.normal(size=(3, 20, 3))
    other = pinocchio_torque(model, theta, *states)
    np.testing.assert_allclose(other, model.torque(*states, theta), atol=1e-9 * np.abs(other).max())


def test_without_a_urdf_as_it_stands_or_pinocchio_there_is_none(monkeypatch):
    states = np.zeros((3, 1, 2))
    assert pinocchio_torque(two_link_arm(), two_link_arm().values, *states) is None
    bodies = RigidBodies(ARM_MJCF, source="arm.xml")
    assert pinocchio_torque(Model((bodies,)), np.zeros(30), *np.zeros((3, 1, 3))) is None
    bodies = RigidBodies(ARM, source="arm")
    moved = bodies.with_displacement("rail", (0.01,) + (0.0,) * 8)
    assert pinocchio_torque(Model((moved,)), np.zeros(30), *np.zeros((3, 1, 3))) is None
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    assert pinocchio_torque(replace(Model((bodies,))), np.zeros(30), *np.zeros((3, 1, 3))) is None
