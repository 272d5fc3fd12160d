"""What an arm does beside the motion: constant speeds and poses, within their share of the time."""

from dataclasses import replace
from functools import cache
from importlib import import_module

import numpy as np
import pytest

from dynident.apps.excitation import MotionRequest, Program, Purpose, Trajectory, min_fit_speeds, verify
from dynident.apps.excitation.design import FRICTION_SHARE, GRAVITY_SHARE, home_pose, slow_pieces, torque_information
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.programs import (
    HOLD_TIME,
    TooShortError,
    friction_program,
    gravity_program,
    select_informative_poses,
)
from dynident.apps.excitation.trajectory import Hold
from dynident.models import Model
from dynident.models.friction import Coulomb
from dynident.runtime import ConfigError
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post, smooth_and_at_rest
from tests.apps.excitation.requests import OPEN, REQUEST

START = np.array([-1.0, 0.3])


def test_it_keeps_the_limits_and_the_clearance_and_fills_its_time():
    pieces = friction_program(AROUND, 90.0, START, np.random.default_rng(0))
    trajectory = Trajectory(LIMITS.joints, pieces)
    np.testing.assert_allclose(smooth_and_at_rest(trajectory), [START, START], atol=1e-9)
    assert verify(trajectory, Feasibility(MODEL, THETA, LIMITS, Post(), 0.02)).nearest.distance >= 0.02
    assert 0.95 * 90.0 < trajectory.duration <= 90.0


def test_each_joint_goes_to_and_fro_over_the_same_way_at_each_speed_slow_to_fast():
    pieces = friction_program(FREE, 60.0, None, np.random.default_rng(0), speeds=4)
    for joint, name in enumerate(LIMITS.joints):
        sweeps = [piece.course for piece in pieces if piece.purpose is Purpose.FRICTION and piece.label == name]
        assert len(sweeps) == 8
        assert (np.array([sweep.direction for sweep in sweeps]) == np.eye(2)[joint]).all()
        speeds = [sweep.speed for sweep in sweeps]
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
    speeds = [piece.course.speed for piece in pieces if piece.label == "lift"]
    assert min(speeds) == pytest.approx(1.5 * min_fit_speeds(MODEL, LIMITS)[0])
    assert min(speeds) > max(speeds) / 20


def test_where_the_torque_does_not_suffice_the_joint_starts_more_gently():
    weak = replace(FREE, limits=replace(LIMITS, torque=np.array([13.0, 4.5])))
    used = []
    for feasible in (FREE, weak):
        pieces = friction_program(feasible, 60.0, START, np.random.default_rng(0))
        verify(Trajectory(LIMITS.joints, pieces), Feasibility(MODEL, THETA, feasible.limits))
        used.append({piece.course.ramp.acceleration for piece in pieces if piece.label == "lift"})
    assert used[0] == {LIMITS.acceleration[0]}
    assert max(used[1]) <= LIMITS.acceleration[0] / 2


def test_too_little_time_and_no_room_are_said():
    with pytest.raises(ConfigError, match=r"takes \d+\.\d s for 2 joints, .* but has 5\.0 s"):
        friction_program(FREE, 5.0, None, np.random.default_rng(0))
    with pytest.raises(ConfigError, match="no way was found"):
        friction_program(AROUND, 60.0, np.zeros(2), np.random.default_rng(0))


WEIGHTS = np.array([1.0, 4.0])
BODIES, VISCOUS, COULOMB, OFFSET = MODEL.terms
SMOOTH = replace(AROUND, model=Model((BODIES, VISCOUS, OFFSET), name="smooth.urdf"), theta=np.delete(THETA, [22, 23]))
ONE = replace(
    AROUND, model=Model((BODIES, VISCOUS, Coulomb(COULOMB.joints, on=("bend",)), OFFSET)), theta=np.delete(THETA, 22)
)
SLOW = min_fit_speeds(MODEL, LIMITS)


def information(poses):
    rows = MODEL.regressor(poses, 0 * poses, 0 * poses) * np.sqrt(WEIGHTS)[:, None]
    sizes = np.linalg.svd(rows.reshape(-1, rows.shape[2]), compute_uv=False)
    return np.log(sizes[:6]).sum() if sizes[5] > 1e-6 else -np.inf  # four of gravity, two offsets


@cache
def gravity_pieces(feasible, start, duration=40.0):
    request = MotionRequest(1 / np.sqrt(WEIGHTS), duration=duration, start=None if start is None else np.array(start))
    return gravity_program(feasible, request, np.random.default_rng(1))


def visits(pieces):
    courses = {}
    for piece in pieces:
        if piece.purpose is Purpose.POSE:
            courses.setdefault(piece.label, []).append(piece.course)
    return courses


def test_chosen_poses_tell_more_than_random_ones():
    rng = np.random.default_rng(0)
    poses = FREE.random_poses(400, rng)
    chosen = information(poses[select_informative_poses(FREE, poses, WEIGHTS, 6)])
    assert chosen > max(information(FREE.random_poses(6, rng)) for _ in range(100))


@pytest.mark.parametrize(
    ("feasible", "start"),
    [(AROUND, None), (SMOOTH, None), (ONE, (-1.0, 0.3))],
    ids=["dry friction", "none", "of one joint, from a start"],
)
def test_poses_are_visited_within_the_limits_and_the_time(feasible, start):
    pieces = gravity_pieces(feasible, start)
    trajectory = Trajectory(LIMITS.joints, pieces)
    first, last = smooth_and_at_rest(trajectory)
    np.testing.assert_allclose([first, last], [first if start is None else start] * 2, atol=1e-9)
    verify(trajectory, Feasibility(feasible.model, feasible.theta, LIMITS, Post(), 0.02))
    courses = visits(pieces)
    assert list(courses) == [str(k + 1) for k in range(len(courses))]
    assert [sum(x.duration for x in each) for each in courses.values()] == pytest.approx([HOLD_TIME] * len(courses))
    assert len(courses) >= 8
    assert 30.0 < trajectory.duration <= 40.0


def test_without_dry_friction_poses_are_held():
    assert {type(x) for each in visits(gravity_pieces(SMOOTH, None)).values() for x in each} == {Hold}


def test_where_joints_have_dry_friction_they_pass_to_and_fro_over_one_way_at_a_speed_that_counts():
    signs = set()
    for there, back in visits(gravity_pieces(AROUND, None)).values():
        np.testing.assert_allclose(there.end, back.pose)
        np.testing.assert_allclose(back.end, there.pose)
        speeds = [x.states(np.array([x.duration / 2]))[1, 0] for x in (there, back)]
        np.testing.assert_allclose(speeds[0], -speeds[1])
        np.testing.assert_allclose(np.abs(speeds[0]), 2 * SLOW)
        assert there.cruise > 0.5 * there.duration
        signs.add(bool(np.prod(speeds[0]) > 0))
    assert signs == {True, False}


def test_passing_shows_more_of_gravity_than_holding():
    """The torque at random poses at rest is expected with smaller errors after as long a program."""
    poses = FREE.random_poses(300, np.random.default_rng(3))
    rows = MODEL.regressor(poses, 0 * poses, 0 * poses).reshape(-1, len(THETA))
    errors = []
    for pieces in (gravity_pieces(AROUND, None), gravity_pieces(SMOOTH, None)):
        path = Trajectory(LIMITS.joints, pieces)
        M = torque_information(MODEL, path.states(path.times(100.0)), WEIGHTS, SLOW)
        M = M / path.duration
        errors.append(np.sqrt(np.einsum("ij,jk,ik->i", rows, np.linalg.pinv(M, rcond=1e-10, hermitian=True), rows)))
    assert np.median(errors[0]) < 0.8 * np.median(errors[1])


def test_too_little_time_for_poses_is_said():
    with pytest.raises(ConfigError, match=r"has 2\.0 s, too little to reach a pose"):
        gravity_pieces(FREE, (-1.0, 0.3), 2.0)
    with pytest.raises(ConfigError, match="in none of 400 poses can all joints with dry friction move slowly"):
        gravity_pieces(replace(FREE, limits=replace(LIMITS, lower=LIMITS.lower / 100, upper=LIMITS.upper / 100)), None)


OPEN_SPACE = Feasibility(MODEL, THETA, LIMITS, OPEN, REQUEST.clearance)


def pieces(program, duration, start=None, seed=0):
    request = replace(REQUEST, program=program, duration=duration, start=start)
    return slow_pieces(OPEN_SPACE, request, np.random.default_rng(seed))


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


def test_too_little_time_is_said_with_what_is_enough_for_both_programs():
    start = np.array([0.5, 0.5])
    words = r"^of the duration of 5 s, 40% are for friction.*set `duration` to \d+ s or more"
    with pytest.raises(TooShortError, match=words) as caught:
        pieces(Program.ALL, 5.0, start)
    with pytest.raises(TooShortError):
        pieces(Program.ALL, 0.98 * caught.value.shortest, start)
    duration = np.ceil(caught.value.shortest)
    both = pieces(Program.ALL, duration, start)
    assert {piece.purpose for piece in both} == {Purpose.FRICTION, Purpose.POSE, Purpose.WAY}
    trajectory, share = Trajectory(LIMITS.joints, both), FRICTION_SHARE + GRAVITY_SHARE
    assert 0.5 * share * duration < trajectory.duration <= share * duration * (1 + 1e-9)
    np.testing.assert_allclose(smooth_and_at_rest(trajectory), [start, start], atol=1e-9)
    np.testing.assert_allclose(home_pose(both), start)
