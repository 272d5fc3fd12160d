"""The direction of gravity that torques ask for, on simulated arms that are mounted in other ways than assumed."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.checks import run_checks
from dynident.checks.file_notes import OtherGravity
from dynident.checks.robot import gravity_findings
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Viscous
from dynident.models.lagrangian import slider
from dynident.motion.log import Log, Motion
from tests.checks.moving_arm import waves
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


@cache
def motion(gravity: tuple[float, float, float]) -> Motion:
    """The arm moves with inertias that differ from the file's by up to 40 %."""
    model, rng = arm(gravity), np.random.default_rng(3)
    theta = np.array([1.0 if x.value is None else x.value for x in model.parameters])
    theta[:40] *= np.repeat(rng.uniform(0.6, 1.4, 4), 10)
    return waves(model, theta, 1.1 + 0.6 * np.arange(4), 1.2 - 0.2 * np.arange(4), noise=0.05, t=T)


NONE, FLAT, UPRIGHT = (0.0, 0.0, 0.0), (0.0, 0.0, -9.81), (0.0, -9.81, 0.0)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 9.81), (9.81, 0.0, 0.0), (0.0, -6.9, -6.9)])
def test_an_arm_that_is_mounted_otherwise_is_asked_about(gravity) -> None:
    (result,) = gravity_findings(arm(), [motion(gravity)])
    assert isinstance(result.message, OtherGravity)
    assert result.message.assumed == (0.0, 0.0, -9.81)
    said = result.message.fitted
    assert np.dot(said, gravity) > 0.95 * np.linalg.norm(said) * np.linalg.norm(gravity)
    assert list(gravity_findings(arm(gravity), [motion(gravity)])) == []


def test_gravity_that_was_left_out_is_asked_about() -> None:
    (result,) = gravity_findings(arm(NONE), [motion(FLAT)])
    assert result.message.assumed == NONE
    assert result.message.fitted[2] < -5
    assert list(gravity_findings(arm(NONE), [motion(NONE)])) == []


def test_turned_torques_and_what_cannot_tell_raise_no_question() -> None:
    moved, zeros = motion(FLAT), np.zeros((len(T), 4))
    turned, silent = replace(moved, tau=-moved.tau), replace(moved, tau=zeros)
    still = replace(motion((0.0, 0.0, 9.81)), q=zeros, dq=zeros)
    assert [list(gravity_findings(arm(), [x])) for x in (moved, turned, silent, still)] == [[]] * 4
    model = slider()
    names = tuple(x.name for x in model.joints)
    assert list(gravity_findings(model, [Motion(T, *np.ones((4, len(T), 1)), names, np.ones(len(T), bool))])) == []


PLANAR = urdf(
    link("base", 10.0),
    link("upper", 3.0, (0.2, 0.02, 0.02), tensor=np.diag([0.01, 0.05, 0.05])),
    link("fore", 2.0, (0.15, 0.03, 0.01), tensor=np.diag([0.008, 0.02, 0.02])),
    joint("j1", "revolute", "base", "upper"),
    joint("j2", "revolute", "upper", "fore", (0.4, 0.0, 0.0)),
)


def planar(gravity) -> Model:
    bodies = RigidBodies(PLANAR, gravity=gravity)
    return Model((bodies, Viscous(bodies.joints)))


@cache
def swung(gravity: tuple[float, float, float]) -> Motion:
    """The planar arm swings, its joints' axes along z."""
    model = planar(gravity)
    theta = np.array([1.0 if x.value is None else x.value for x in model.parameters])
    return waves(model, theta, [2.1, 3.4], [1.0, 1.0], seed=3, t=T)


@pytest.mark.parametrize("assumed", [NONE, FLAT])
def test_of_a_planar_arm_the_gravity_in_its_plane_is_told(assumed) -> None:
    """That along the axes of its joints does not act."""
    assert list(gravity_findings(planar(assumed), [swung(FLAT)])) == []
    (result,) = gravity_findings(planar(assumed), [swung(UPRIGHT)])
    np.testing.assert_allclose(result.message.fitted, UPRIGHT, atol=0.5)
    assert list(gravity_findings(planar(UPRIGHT), [swung(UPRIGHT)])) == []
    tilted = 9.81 * np.array([0.0, -0.5, -0.866])
    assert list(gravity_findings(planar(FLAT), [swung(tuple(tilted))])) == []


@pytest.mark.parametrize("given", [NONE, FLAT])
def test_a_planar_arm_that_lies_flat_is_asked_nothing(given) -> None:
    moved, rng = swung(NONE), np.random.default_rng(4)
    log = Log(T, moved.q + 1e-5 * rng.standard_normal(moved.q.shape), moved.tau, moved.joints)
    topics = {finding.topic for finding in run_checks(planar(given), {"train": {"log": log}}).findings}
    assert not topics & {"gravity", "gravity compensated", "base tilt", "missing term", "slow"}
