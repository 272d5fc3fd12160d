"""Each joint alone at constant speeds, to and fro, slow to fast."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation import Purpose, Trajectory, min_fit_speeds, verify
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.programs import friction_program
from dynident.runtime import ConfigError
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post, smooth_and_at_rest

START = np.array([-1.0, 0.3])


@pytest.mark.parametrize("start", [None, START])
@pytest.mark.parametrize("duration", [40.0, 90.0])
def test_it_keeps_the_limits_and_the_clearance_and_fills_its_time(start, duration):
    pieces = friction_program(AROUND, duration, start, np.random.default_rng(0))
    trajectory = Trajectory(LIMITS.joints, pieces)
    first, last = smooth_and_at_rest(trajectory)
    np.testing.assert_allclose(first, last, atol=1e-9)
    if start is not None:
        np.testing.assert_allclose(first, start, atol=1e-9)
    assert verify(trajectory, Feasibility(MODEL, THETA, LIMITS, Post(), 0.02)).nearest.distance >= 0.02
    assert 0.95 * duration < trajectory.duration <= duration


def test_each_joint_goes_to_and_fro_over_the_same_way_at_each_speed_slow_to_fast():
    pieces = friction_program(FREE, 60.0, None, np.random.default_rng(0), speeds=4)
    for joint, name in enumerate(LIMITS.joints):
        sweeps = [one.course for one in pieces if one.purpose is Purpose.FRICTION and one.label == name]
        assert len(sweeps) == 8
        assert (np.array([one.direction for one in sweeps]) == np.eye(2)[joint]).all()
        speeds = [one.speed for one in sweeps]
        assert speeds == sorted(speeds)
        assert max(speeds) == pytest.approx(LIMITS.velocity[joint])
        assert max(speeds) == pytest.approx(20 * min(speeds))
        for there, back in zip(sweeps[::2], sweeps[1::2], strict=True):
            assert there.distance == -back.distance
            np.testing.assert_allclose(there.end, back.pose)
            assert there.cruise > 0.1


def test_where_there_is_little_room_the_slowest_speed_is_above_what_a_fit_leaves_out():
    narrow = replace(FREE, limits=replace(LIMITS, lower=LIMITS.lower / 12, upper=LIMITS.upper / 12))
    pieces = friction_program(narrow, 60.0, None, np.random.default_rng(0))
    speeds = [one.course.speed for one in pieces if one.label == "lift"]
    assert min(speeds) == pytest.approx(1.5 * min_fit_speeds(MODEL, LIMITS)[0])
    assert min(speeds) > max(speeds) / 20


def test_where_the_torque_does_not_suffice_the_joint_starts_more_gently():
    weak = replace(FREE, limits=replace(LIMITS, torque=np.array([13.0, 4.5])))
    used = []
    for feasible in (FREE, weak):
        pieces = friction_program(feasible, 60.0, START, np.random.default_rng(0))
        verify(Trajectory(LIMITS.joints, pieces), Feasibility(MODEL, THETA, feasible.limits))
        used.append({one.course.acceleration for one in pieces if one.label == "lift"})
    assert used[0] == {LIMITS.acceleration[0]}
    assert max(used[1]) <= LIMITS.acceleration[0] / 2


def test_too_little_time_and_no_room_are_said():
    with pytest.raises(ConfigError, match=r"takes \d+\.\d s for 2 joints, .* but has 5\.0 s"):
        friction_program(FREE, 5.0, None, np.random.default_rng(0))
    with pytest.raises(ConfigError, match="no way was found"):
        friction_program(AROUND, 60.0, np.zeros(2), np.random.default_rng(0))
