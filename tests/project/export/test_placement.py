"""What a robot file cannot hold goes where it can: the same torque, and bodies that are physical."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import PhysicallyConsistent
from dynident.estimators.cone import minimise
from dynident.identification import Recipe, identify
from dynident.models import Model, RigidBodies, RotorInertia, consistency_violations
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.simulation import record, simulate
from dynident.motion.smoothers import Spline
from dynident.project.export import IdentifiedModel, exports, random_states
from dynident.project.export.written import place_values
from dynident.runtime import ConfigError, ModelError
from tests.robots import joint, link, urdf

ROTORS = (0.5, 0.6, 0.3, 0.1, 0.08, 0.05)
PLACES = (
    ((0, 0, 0.16), (0, 0, 0)), ((0, 0, 0), (np.pi / 2, 0, 0)), ((-0.425, 0, 0), (0, 0, 0)),
    ((-0.39, 0, 0.13), (0, 0, 0)), ((0, -0.1, 0), (np.pi / 2, 0, 0)), ((0, 0.1, 0), (np.pi / 2, np.pi, np.pi)),
)  # fmt: skip
LINKS = (
    (3.7, (0, -0.02, -0.03), (0.014, 0.014, 0.0104)), (8.4, (0.21, 0, 0.11), (0.13, 0.13, 0.015)),
    (2.3, (0.12, 0, 0.03), (0.03, 0.03, 0.004)), (1.2, (0, 0, 0.01), (0.002, 0.002, 0.0012)),
    (1.2, (0, 0, 0.01), (0.002, 0.002, 0.0012)), (0.25, (0, 0, -0.02), (1e-4, 1e-4, 1.5e-4)),
)  # fmt: skip


def six_axes(rotors=ROTORS, offset=0.0):
    """An arm with the axes of a UR5, a vertical one first, and the rotor inertias given."""
    parts, before = [link("base")], "base"
    for k, ((mass, centre, moments), place) in enumerate(zip(LINKS, PLACES, strict=True), 1):
        parts += [link(f"l{k}", mass, centre, (0, 0, 0), np.diag(moments))]
        parts += [joint(f"j{k}", "revolute", before, f"l{k}", *place)]
        before = f"l{k}"
    bodies = RigidBodies(urdf(*parts))
    joints = bodies.joints
    model = Model((bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints)), name="arm")
    nominal = [parameter.value for parameter in bodies.parameters]
    return IdentifiedModel(model, np.concatenate([nominal, rotors, np.ones(12), np.full(6, offset)]))


def test_where_nothing_can_be_left_of_many_less_is_tried(monkeypatch):
    model, tried = six_axes(), []

    def refusing(*arguments):
        tried.append(1)
        if len(tried) < 3:
            raise (ConfigError if len(tried) == 1 else ModelError)("no")
        return minimise(*arguments)

    monkeypatch.setattr("dynident.project.export.written.minimise", refusing)
    moved = place_values(model, armature=False)
    assert len(tried) > 2
    state = random_states(6, np.random.default_rng(0))
    np.testing.assert_allclose(
        moved.model.torque(*state, moved.value), model.model.torque(*state, model.value), atol=1e-8
    )


def test_bodies_at_the_edge_of_what_is_physical_take_what_they_can():
    """Only what is free without leaving consistency: a mass that is known is not made up."""
    model = six_axes()
    value = model.value.copy()
    value[[4, 6, 9]] = 0.5, 0.5, 0.9932  # link 1 has no room left in its triangle, but for more of both
    edge = place_values(replace(model, value=value), armature=False)
    assert edge.value[60] == pytest.approx(0.0, abs=1e-9)
    assert all(consistency_violations(body) == () for body in edge.bodies[1])


def test_a_file_has_its_own_error_on_the_logs():
    """Of a pendulum about the vertical axis all inertia is one parameter: a URDF loses the constant torque alone."""
    text = urdf(link("base"), link("arm", 2.0, (0.1, 0, 0), (0, 0, 0), np.diag([0.1, 0.1, 0.15])),
                joint("turn", "revolute", "base", "arm"))  # fmt: skip
    bodies = RigidBodies(text)
    model = Model((bodies, RotorInertia(bodies.joints), Offset(bodies.joints)), name="turn")
    theta = np.concatenate([[parameter.value for parameter in bodies.parameters], [0.4, 0.3]])
    motion = simulate(model, theta, lambda s: [np.sin(3 * s)], np.arange(2001) * 0.005, tolerance=1e-9)
    log = record(motion, 1e-6, 1e-3, np.random.default_rng(0)).log
    recipe = Recipe(smoother=Spline(sigma=1e-6), estimator=PhysicallyConsistent())
    urdf_file, *others = exports(identify(model, [log], [log], recipe))
    assert [error.role for error in urdf_file.errors] == ["train", "validation"]
    error = urdf_file.errors[1]
    share = 100 * 0.3 * np.sqrt(len(log.t)) / np.linalg.norm(log.tau)
    assert error.file == pytest.approx(
        np.hypot(error.model, share), rel=0.01
    )  # the constant torque, and nothing of the rotor
    assert all(error.file == error.model for other in others for error in other.errors)
