"""The direction of gravity that torques ask for, on simulated arms that are mounted in other ways than assumed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import run_checks
from dynident.checks.file_notes import OtherGravity
from dynident.checks.robot import gravity_findings
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Viscous
from dynident.models.lagrangian import slider
from dynident.motion.log import Log, Motion
from tests.robots import joint, link, urdf

FOUR = urdf(
    link("base", 10.0),
    *(link(f"l{k}", 5.0 - k, (0.12, 0.02, 0.05), tensor=np.diag([0.02, 0.04, 0.04])) for k in range(1, 5)),
    joint("j1", "revolute", "base", "l1", (0.0, 0.0, 0.3)),
    joint("j2", "revolute", "l1", "l2", (0.0, 0.0, 0.2), axis=(0, 1, 0)),
    joint("j3", "revolute", "l2", "l3", (0.4, 0.0, 0.0), axis=(0, 1, 0)),
    joint("j4", "revolute", "l3", "l4", (0.3, 0.0, 0.0), axis=(1, 0, 0)),
)
T = np.arange(0, 20, 0.01)


def arm(gravity=(0.0, 0.0, -9.81)) -> Model:
    bodies = RigidBodies(FOUR, gravity=gravity)
    return Model((bodies, RotorInertia(bodies.joints), Viscous(bodies.joints), Coulomb(bodies.joints)))


def motion(gravity, gain=1.0) -> Motion:
    """The arm moves with inertias that differ from the file's by up to 40 %."""
    model, rng = arm(gravity), np.random.default_rng(3)
    theta = np.array([1.0 if x.value is None else x.value for x in model.parameters])
    theta[:40] *= np.repeat(rng.uniform(0.6, 1.4, 4), 10)
    rates, sizes = 1.1 + 0.6 * np.arange(4), 1.2 - 0.2 * np.arange(4)
    wave = np.outer(T, rates)
    q, dq, ddq = sizes * np.sin(wave), sizes * rates * np.cos(wave), -sizes * rates**2 * np.sin(wave)
    tau = model.torque(q, dq, ddq, theta)
    tau += 0.05 * tau.std(axis=0) * rng.standard_normal(tau.shape)
    return Motion(T, q, dq, ddq, gain * tau, tuple(x.name for x in model.joints), np.ones(len(T), bool))


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 9.81), (9.81, 0.0, 0.0), (0.0, -6.9, -6.9)])
def test_an_arm_that_is_mounted_otherwise_is_asked_about(gravity) -> None:
    (found,) = gravity_findings(arm(), [motion(gravity)])
    assert isinstance(found.message, OtherGravity)
    assert found.message.assumed == (0.0, 0.0, -9.81)
    said = found.message.fitted
    assert np.dot(said, gravity) > 0.95 * np.linalg.norm(said) * np.linalg.norm(gravity)
    assert list(gravity_findings(arm(gravity), [motion(gravity)])) == []


def test_a_right_gravity_and_turned_torques_raise_no_question() -> None:
    assert list(gravity_findings(arm(), [motion((0.0, 0.0, -9.81))])) == []
    assert list(gravity_findings(arm(), [motion((0.0, 0.0, -9.81), gain=-1.0)])) == []


def test_gravity_that_was_left_out_is_asked_about() -> None:
    none, usual = (0.0, 0.0, 0.0), (0.0, 0.0, -9.81)
    (found,) = gravity_findings(arm(none), [motion(usual)])
    assert found.message.assumed == none
    assert found.message.fitted[2] < -5
    assert list(gravity_findings(arm(none), [motion(none)])) == []


def test_torques_that_are_all_zero_raise_no_question() -> None:
    assert list(gravity_findings(arm(), [replace(motion((0.0, 0.0, -9.81)), tau=np.zeros((len(T), 4)))])) == []


def test_what_cannot_tell_says_nothing() -> None:
    still = replace(motion((0.0, 0.0, 9.81)), q=np.zeros((len(T), 4)), dq=np.zeros((len(T), 4)))
    assert list(gravity_findings(arm(), [still])) == []
    model = slider()
    n = len(model.joints)
    moved = Motion(T, *np.ones((4, len(T), n)), tuple(x.name for x in model.joints), np.ones(len(T), bool))
    assert list(gravity_findings(model, [moved])) == []


PLANAR = urdf(
    link("base", 10.0),
    link("upper", 3.0, (0.2, 0.02, 0.02), tensor=np.diag([0.01, 0.05, 0.05])),
    link("fore", 2.0, (0.15, 0.03, 0.01), tensor=np.diag([0.008, 0.02, 0.02])),
    joint("j1", "revolute", "base", "upper"),
    joint("j2", "revolute", "upper", "fore", (0.4, 0.0, 0.0)),
)
NONE, FLAT, UPRIGHT = (0.0, 0.0, 0.0), (0.0, 0.0, -9.81), (0.0, -9.81, 0.0)


def planar(gravity) -> Model:
    bodies = RigidBodies(PLANAR, gravity=gravity)
    return Model((bodies, Viscous(bodies.joints)))


def swung(gravity) -> Motion:
    """The planar arm swings, its joints' axes along z."""
    model, rng = planar(gravity), np.random.default_rng(3)
    theta = np.array([1.0 if x.value is None else x.value for x in model.parameters])
    rates, wave = np.array([2.1, 3.4]), np.outer(T, [2.1, 3.4])
    tau = model.torque(np.sin(wave), rates * np.cos(wave), -(rates**2) * np.sin(wave), theta)
    tau += 0.02 * tau.std(axis=0) * rng.standard_normal(tau.shape)
    moved = np.sin(wave), rates * np.cos(wave), -(rates**2) * np.sin(wave), tau
    return Motion(T, *moved, ("j1", "j2"), np.ones(len(T), bool))


@pytest.mark.parametrize("assumed", [NONE, FLAT])
def test_of_a_planar_arm_the_gravity_in_its_plane_is_told(assumed) -> None:
    """That along the axes of its joints does not act."""
    assert list(gravity_findings(planar(assumed), [swung(FLAT)])) == []
    (found,) = gravity_findings(planar(assumed), [swung(UPRIGHT)])
    np.testing.assert_allclose(found.message.fitted, UPRIGHT, atol=0.5)
    assert list(gravity_findings(planar(UPRIGHT), [swung(UPRIGHT)])) == []
    tilted = 9.81 * np.array([0.0, -0.5, -0.866])
    assert list(gravity_findings(planar(FLAT), [swung(tuple(tilted))])) == []


@pytest.mark.parametrize("given", [NONE, FLAT])
def test_a_planar_arm_that_lies_flat_is_asked_nothing(given) -> None:
    moved, rng = swung(NONE), np.random.default_rng(4)
    log = Log(T, moved.q + 1e-5 * rng.standard_normal(moved.q.shape), moved.tau, moved.joints)
    topics = {one.topic for one in run_checks(planar(given), {"train": {"log": log}}).findings}
    assert not topics & {"gravity", "gravity compensated", "base tilt", "missing term", "slow"}
