"""Ways from pose to pose: straight where that is free, around what is in the way, slower for the torque."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dynident.excitation.trajectories.quintic import at_rest
from dynident.excitation.trajectories.trajectory import Piece, Purpose, Trajectory
from dynident.excitation.trajectories.way import direct, way
from dynident.excitation.verify import verify
from tests.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post

LOW, HIGH = np.array([-0.6, 0.0]), np.array([0.6, 0.0])


def test_a_free_way_is_one_quintic():
    (course,) = way(FREE, LOW, HIGH, np.random.default_rng(0))
    assert course.states(np.array([0.0, course.duration]))[0].tolist() == pytest.approx(np.array([LOW, HIGH]))
    assert way(FREE, LOW, LOW, np.random.default_rng(0)) == ()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_way_goes_around_what_is_between(seed):
    assert direct(AROUND, at_rest(LOW), at_rest(HIGH)) is None
    found = way(AROUND, LOW, HIGH, np.random.default_rng(seed))
    assert len(found) > 1
    for one, other in pairwise(found):
        np.testing.assert_array_equal(one.end, other.start)
    trajectory = Trajectory(LIMITS.joints, tuple(Piece(one, Purpose.WAY) for one in found))
    checked = verify(trajectory, MODEL, THETA, LIMITS, Post(), 0.02)
    assert checked.nearest.distance >= 0.02
    np.testing.assert_allclose(trajectory.states(np.array([0.0, 1e9]))[0], [LOW, HIGH], atol=1e-12)


def test_where_the_torque_does_not_suffice_the_way_takes_longer():
    usual = direct(FREE, at_rest(LOW), at_rest(HIGH))
    weak = replace(FREE, limits=replace(LIMITS, torque=0.92 * FREE.effort(usual) * LIMITS.torque))
    slower = direct(weak, at_rest(LOW), at_rest(HIGH))
    assert slower.duration > 1.15 * usual.duration
    assert weak.effort(slower) <= 0.98


def test_there_is_no_way_into_what_is_in_the_way_or_out_of_the_range():
    rng = np.random.default_rng(0)
    assert way(AROUND, LOW, np.zeros(2), rng) is None
    assert way(FREE, LOW, np.array([3.0, 0.0]), rng) is None
    walls = replace(AROUND, space=Walls())
    assert walls.stands(np.stack([LOW, HIGH])).all()
    assert way(walls, LOW, HIGH, rng) is None


class Walls:
    """The first joint cannot pass zero."""

    pairs = (("upper", "wall"),)

    def distances(self, q):
        return np.abs(q[:, :1]) - 0.2
