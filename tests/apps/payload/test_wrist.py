"""Which turning of a joint would show what of a payload."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.payload import mount_of
from dynident.apps.payload.body import BodyEstimate, Turning, _centre_pose, best_turning, turnings
from dynident.models import RigidBodies
from tests.apps.payload.arms import CARRIED, SIX, arm


def test_turning_the_last_joint_shows_the_inertia_about_its_axis() -> None:
    model, _ = arm()
    known = np.diag([1e6, *[1e6] * 3, *[1e2] * 6])
    ways = turnings(model, mount_of(model), BodyEstimate(CARRIED, known), np.full(6, 1e-3), np.zeros((4, 6)))
    assert [way.joint for way in ways] == ["j1", "j2", "j3", "j4", "j5", "j6"]
    assert best_turning(ways, 9).joint in ("j4", "j6")
    assert best_turning(ways, 6).joint not in ("j6",)
    before = np.sqrt(np.diag(np.linalg.inv(known)))
    assert (best_turning(ways, 9).std[9], best_turning(ways, 6).std[6]) < (before[9], before[6])
    assert {way.speed for way in ways} == {1.5}


def test_a_joint_turns_within_its_limits() -> None:
    model, _ = arm()
    limited = SIX.replace('type="continuous"', 'type="revolute"').replace(
        "<axis", '<limit effort="9" velocity="1" lower="0.1" upper="0.5"/><axis'
    )
    bodies = RigidBodies(limited)
    slow = replace(model, terms=(bodies, *model.terms[1:]))
    ways = turnings(slow, mount_of(slow), BodyEstimate(CARRIED, np.eye(10)), np.ones(6), np.zeros((4, 6)))
    assert [way.speed for way in ways] == pytest.approx([0.7] * 6)
    assert _centre_pose(slow, 0, np.zeros(6), 0.8)[0] == pytest.approx(0.3)


def test_of_joints_that_do_as_well_the_last_is_named() -> None:
    ways = [Turning(name, 1.0, np.array([std])) for name, std in (("a", 1.0), ("b", 1.1), ("c", 2.0))]
    assert best_turning(ways, 0).joint == "b"
