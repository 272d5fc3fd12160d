"""Poses at rest that tell of gravity."""

import numpy as np
import pytest

from dynident.errors import ConfigError
from dynident.excitation.trajectories.poses import informative_poses, static_poses
from dynident.excitation.trajectories.trajectory import Purpose, Trajectory
from dynident.excitation.verify import verify
from tests.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post, smooth_and_at_rest

WEIGHTS = np.array([1.0, 4.0])


def information(poses):
    rows = MODEL.regressor(poses, 0 * poses, 0 * poses) * np.sqrt(WEIGHTS)[:, None]
    sizes = np.linalg.svd(rows.reshape(-1, rows.shape[2]), compute_uv=False)
    return np.log(sizes[:6]).sum() if sizes[5] > 1e-6 else -np.inf  # four of gravity, two offsets


def test_chosen_poses_tell_more_than_random_ones():
    rng = np.random.default_rng(0)
    chosen = information(informative_poses(FREE, WEIGHTS, 6, rng))
    assert chosen > max(information(FREE.poses(6, rng)) for _ in range(100))


@pytest.mark.parametrize("start", [None, np.array([-1.0, 0.3])])
def test_poses_are_held_and_reached_within_the_limits_and_the_time(start):
    pieces = static_poses(AROUND, 40.0, start, WEIGHTS, np.random.default_rng(1), hold=1.5)
    trajectory = Trajectory(LIMITS.joints, pieces)
    first, last = smooth_and_at_rest(trajectory)
    np.testing.assert_allclose(first, last, atol=1e-9)
    verify(trajectory, MODEL, THETA, LIMITS, Post(), 0.02)
    held = [one for one in pieces if one.purpose is Purpose.POSE]
    assert [one.label for one in held] == [str(k + 1) for k in range(len(held))]
    assert {one.course.duration for one in held} == {1.5}
    assert len(held) >= 8
    assert 30.0 < trajectory.duration <= 40.0


def test_too_little_time_is_said():
    with pytest.raises(ConfigError, match=r"has 2\.0 s, too little to reach a pose"):
        static_poses(FREE, 2.0, np.array([-1.0, 0.3]), WEIGHTS, np.random.default_rng(1))
