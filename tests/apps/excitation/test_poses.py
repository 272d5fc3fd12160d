"""Poses that tell of gravity: held, or passed slowly where friction would hold the joints."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation import MotionRequest, Purpose, Trajectory, min_fit_speeds, verify
from dynident.apps.excitation.design import torque_information
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.programs import gravity_program, select_informative_poses
from dynident.apps.excitation.trajectory import Hold
from dynident.models import Model
from dynident.models.friction import Coulomb
from dynident.runtime import ConfigError
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post, smooth_and_at_rest

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


def made(feasible, duration=40.0, start=None, seed=1, **given):
    request = MotionRequest(1 / np.sqrt(WEIGHTS), duration=duration, start=start)
    return gravity_program(feasible, request, np.random.default_rng(seed), **given)


def visits(pieces):
    found = {}
    for one in pieces:
        if one.purpose is Purpose.POSE:
            found.setdefault(one.label, []).append(one.course)
    return found


def test_chosen_poses_tell_more_than_random_ones():
    rng = np.random.default_rng(0)
    poses = FREE.random_poses(400, rng)
    chosen = information(poses[select_informative_poses(FREE, poses, WEIGHTS, 6)])
    assert chosen > max(information(FREE.random_poses(6, rng)) for _ in range(100))


@pytest.mark.parametrize("start", [None, np.array([-1.0, 0.3])])
@pytest.mark.parametrize("feasible", [AROUND, SMOOTH, ONE], ids=["dry friction", "none", "of one joint"])
def test_poses_are_visited_within_the_limits_and_the_time(feasible, start):
    pieces = made(feasible, start=start, hold=1.5)
    trajectory = Trajectory(LIMITS.joints, pieces)
    first, last = smooth_and_at_rest(trajectory)
    np.testing.assert_allclose(first, last, atol=1e-9)
    verify(trajectory, Feasibility(feasible.model, feasible.theta, LIMITS, Post(), 0.02))
    found = visits(pieces)
    assert list(found) == [str(k + 1) for k in range(len(found))]
    assert [sum(one.duration for one in each) for each in found.values()] == pytest.approx([1.5] * len(found))
    assert len(found) >= 8
    assert 30.0 < trajectory.duration <= 40.0


def test_without_dry_friction_poses_are_held():
    assert {type(one) for each in visits(made(SMOOTH)).values() for one in each} == {Hold}


def test_where_joints_have_dry_friction_they_pass_to_and_fro_over_one_way_at_a_speed_that_counts():
    signs = set()
    for there, back in visits(made(AROUND)).values():
        np.testing.assert_allclose(there.end, back.pose)
        np.testing.assert_allclose(back.end, there.pose)
        speeds = [one.states(np.array([one.duration / 2]))[1, 0] for one in (there, back)]
        np.testing.assert_allclose(speeds[0], -speeds[1])
        np.testing.assert_allclose(np.abs(speeds[0]), 2 * SLOW)
        assert there.cruise > 0.5 * there.duration
        signs.add(bool(np.prod(speeds[0]) > 0))
    assert signs == {True, False}


def test_a_joint_without_dry_friction_stands_meanwhile():
    for each in visits(made(ONE)).values():
        for one in each:
            moving = np.abs(one.states(np.linspace(0.0, one.duration, 99))[1]).max(axis=0)
            np.testing.assert_allclose(moving, [0.0, 2 * SLOW[1]], rtol=1e-6)


def test_low_limits_of_acceleration_and_jerk_are_kept():
    weak = replace(FREE, limits=replace(LIMITS, acceleration=LIMITS.velocity / 3, jerk=LIMITS.velocity))
    verify(Trajectory(LIMITS.joints, made(weak)), Feasibility(MODEL, THETA, weak.limits))


def test_passing_shows_more_of_gravity_than_holding():
    """The torque at random poses at rest is expected with smaller errors after as long a program."""
    poses = FREE.random_poses(300, np.random.default_rng(3))
    rows = MODEL.regressor(poses, 0 * poses, 0 * poses).reshape(-1, len(THETA))
    errors = []
    for pieces in (made(AROUND), made(replace(SMOOTH, space=AROUND.space))):
        path = Trajectory(LIMITS.joints, pieces)
        M = torque_information(MODEL, path.states(path.times(100.0)), WEIGHTS, SLOW)
        M = M / path.duration
        errors.append(np.sqrt(np.einsum("ij,jk,ik->i", rows, np.linalg.pinv(M, rcond=1e-10, hermitian=True), rows)))
    assert np.median(errors[0]) < 0.8 * np.median(errors[1])


def test_too_little_time_and_no_room_are_said():
    with pytest.raises(ConfigError, match=r"has 2\.0 s, too little to reach a pose"):
        made(FREE, 2.0, np.array([-1.0, 0.3]))
    with pytest.raises(ConfigError, match="in none of 400 poses can all joints with dry friction move slowly"):
        made(replace(FREE, limits=replace(LIMITS, lower=LIMITS.lower / 100, upper=LIMITS.upper / 100)))
