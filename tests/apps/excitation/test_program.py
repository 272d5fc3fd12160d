"""What an arm does beside the motion: within its share of the time, from and to one pose."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from dynident.apps.excitation import Program, Purpose, Trajectory
from dynident.apps.excitation.design import FRICTION_SHARE, GRAVITY_SHARE, home_pose, slow_pieces
from dynident.apps.excitation.limits import Feasibility
from dynident.runtime import ConfigError
from tests.apps.excitation.arms import LIMITS, MODEL, THETA, smooth_and_at_rest
from tests.apps.excitation.requests import OPEN, REQUEST

FREE = Feasibility(MODEL, THETA, LIMITS, OPEN, REQUEST.clearance)


def pieces(program, duration, start=None, seed=0):
    request = replace(REQUEST, program=program, duration=duration, start=start)
    return slow_pieces(FREE, request, np.random.default_rng(seed))


def kinds(found):
    return {piece.purpose for piece in found} - {Purpose.WAY}


def test_the_motion_alone_has_nothing_beside_it():
    assert pieces(Program.MOTION, 10.0) == ()


@pytest.mark.parametrize(
    ("program", "duration", "purposes"),
    [
        (Program.FRICTION, 40.0, {Purpose.FRICTION}),
        (Program.GRAVITY, 20.0, {Purpose.POSE}),
        (Program.ALL, 100.0, {Purpose.FRICTION, Purpose.POSE}),
    ],
)
@pytest.mark.parametrize("start", [None, np.array([0.5, 0.5])])
def test_programs_keep_their_time_and_return(program, duration, purposes, start):
    found = pieces(program, duration, start)
    assert kinds(found) == purposes
    trajectory = Trajectory(LIMITS.joints, found)
    share = FRICTION_SHARE + GRAVITY_SHARE if program is Program.ALL else 1.0
    assert 0.5 * share * duration < trajectory.duration <= share * duration * (1 + 1e-9)
    ends = smooth_and_at_rest(trajectory)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
    np.testing.assert_allclose(home_pose(found), ends[0])
    if start is not None:
        np.testing.assert_allclose(ends[0], start)


def test_less_time_makes_fewer_speeds(monkeypatch):
    tried = []

    def program(feasible, duration, start, rng, speeds):
        tried.append((speeds, rng.normal()))
        if speeds > 3:
            raise ConfigError("no time")
        return ()

    monkeypatch.setattr(import_module("dynident.apps.excitation.design"), "friction_program", program)
    pieces(Program.FRICTION, 10.0)
    assert [speeds for speeds, _ in tried] == [5, 4, 3]
    assert len({drawn for _, drawn in tried}) == 1


def test_too_little_time_is_said_with_the_shares():
    with pytest.raises(ConfigError, match="of the duration of 5 s, 40% are for friction and 20% for poses"):
        pieces(Program.ALL, 5.0)
    with pytest.raises(ConfigError, match="give it more time"):
        pieces(Program.FRICTION, 1.0)
