"""What an arm may do: its torque, and its distance to what is in the way."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation.way import Quintic, rest_state
from dynident.runtime import ConfigError
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post

THERE = Quintic(2.0, rest_state(np.array([-0.6, 0.0])), rest_state(np.array([0.6, 0.0])))


def test_effort_is_the_largest_share_of_a_torque_limit():
    t = np.linspace(0, 2.0, 2001)
    q, dq, ddq, _ = THERE.states(t)
    shares = np.abs(MODEL.torque(q, dq, ddq, THETA)) / LIMITS.torque
    assert FREE.max_torque_share(THERE) == pytest.approx(shares.max(), rel=1e-3)
    weak = replace(FREE, limits=replace(LIMITS, torque=0.9 * np.abs(shares * LIMITS.torque).max(axis=0)))
    assert FREE.allows(THERE)
    assert not weak.allows(THERE)


def test_a_course_through_the_post_is_not_clear():
    assert FREE.is_clear(THERE)
    assert not AROUND.is_clear(THERE)
    assert not AROUND.allows(THERE)
    assert not replace(FREE, space=Post(), clearance=0.0).is_clear(THERE)


def test_poses_stand_within_all_limits_and_are_drawn_from_the_generator():
    poses = AROUND.random_poses(100, np.random.default_rng(0))
    assert poses.shape == (100, 2)
    assert AROUND.can_stand(poses).all()
    assert (Post().distances(poses) >= 0.02).all()
    assert (poses == AROUND.random_poses(100, np.random.default_rng(0))).all()
    outside = np.array([[2.9, 0.0], [0.0, 0.0]])
    assert FREE.can_stand(outside).tolist() == [False, True]
    assert AROUND.can_stand(outside).tolist() == [False, False]


def test_where_the_arm_can_stand_nowhere_the_reason_is_said():
    weak = replace(FREE, limits=replace(LIMITS, torque=np.array([0.2, 15.0])))
    shadow = replace(AROUND, space=Post(radius=2.0))
    with pytest.raises(
        ConfigError, match=r"gravity needs more torque than is allowed, mostly of joint 'lift' \(0\.2\)"
    ):
        replace(weak, theta=THETA + np.array([0.0] * 24 + [50.0, 0.0])).random_poses(3, np.random.default_rng(0))
    with pytest.raises(ConfigError, match="nearer than 20 mm, mostly 'upper' and 'post'"):
        shadow.random_poses(3, np.random.default_rng(0))
