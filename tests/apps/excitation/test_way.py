"""Ways from pose to pose: straight where that is free, around what is in the way, slower for the torque."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dynident.apps.excitation import Piece, Purpose, Trajectory, verify
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.way import direct_path, find_path, rest_state
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post

LOW, HIGH = np.array([-0.6, 0.0]), np.array([0.6, 0.0])


def test_a_free_way_is_one_quintic():
    (course,) = find_path(FREE, LOW, HIGH, np.random.default_rng(0))
    assert course.states(np.array([0.0, course.duration]))[0].tolist() == pytest.approx(np.array([LOW, HIGH]))
    assert find_path(FREE, LOW, LOW, np.random.default_rng(0)) == ()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_way_goes_around_what_is_between(seed):
    assert direct_path(AROUND, rest_state(LOW), rest_state(HIGH)) is None
    found = find_path(AROUND, LOW, HIGH, np.random.default_rng(seed))
    assert len(found) > 1
    for one, other in pairwise(found):
        np.testing.assert_array_equal(one.end, other.start)
    trajectory = Trajectory(LIMITS.joints, tuple(Piece(one, Purpose.WAY) for one in found))
    checked = verify(trajectory, Feasibility(MODEL, THETA, LIMITS, Post(), 0.02))
    assert checked.nearest.distance >= 0.02
    np.testing.assert_allclose(trajectory.states(np.array([0.0, 1e9]))[0], [LOW, HIGH], atol=1e-12)


def test_where_the_torque_does_not_suffice_the_way_takes_longer():
    usual = direct_path(FREE, rest_state(LOW), rest_state(HIGH))
    weak = replace(FREE, limits=replace(LIMITS, torque=0.92 * FREE.max_torque_share(usual) * LIMITS.torque))
    slower = direct_path(weak, rest_state(LOW), rest_state(HIGH))
    assert slower.duration > 1.15 * usual.duration
    assert weak.max_torque_share(slower) <= 0.98


def test_there_is_no_way_into_what_is_in_the_way_or_out_of_the_range():
    rng = np.random.default_rng(0)
    assert find_path(AROUND, LOW, np.zeros(2), rng) is None
    assert find_path(FREE, LOW, np.array([3.0, 0.0]), rng) is None
    walls = replace(AROUND, space=Walls())
    assert walls.can_stand(np.stack([LOW, HIGH])).all()
    assert find_path(walls, LOW, HIGH, rng) is None


class Walls:
    """The first joint cannot pass zero."""

    pairs = (("upper", "wall"),)

    def distances(self, q):
        return np.abs(q[:, :1]) - 0.2
