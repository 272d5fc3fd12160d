"""A spring between two points on both sides of a joint."""

import numpy as np
import pytest

from dynident.models import Joint
from dynident.models.friction import Counterbalance
from dynident.runtime import ModelError

JOINTS = (Joint("base"), Joint("rail", "prismatic"))


def counterbalance(**changed):
    shape = {"base_arm": 0.5, "link_arm": 0.2, "angle": 0.7, "free_length": 0.4} | changed
    return Counterbalance(JOINTS, on=("base",), **shape)


def column(term, q):
    states = np.stack([q, 0 * q], axis=1)
    return term.regressor(states, 0 * states, 0 * states)[:, 0, 0]


def test_the_torque_is_the_slope_of_the_potential():
    def potential(q):
        ends = 0.5 * np.array([np.ones_like(q), 0 * q]), 0.2 * np.array([np.cos(q + 0.7), np.sin(q + 0.7)])
        return 0.5 * (np.linalg.norm(ends[1] - ends[0], axis=0) - 0.4) ** 2

    q, h = np.linspace(-3, 3, 40), 1e-5
    slope = (potential(q + h) - potential(q - h)) / (2 * h)
    np.testing.assert_allclose(column(counterbalance(), q), slope, atol=1e-10)


def test_equal_arms_that_meet_give_no_torque():
    term, q = counterbalance(link_arm=0.5, angle=0.0), np.zeros(1)
    assert column(term, q) == 0.0
    assert np.isfinite(term.partials(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1)).q).all()


def test_it_is_for_joints_that_turn():
    with pytest.raises(ModelError, match="joint 'rail' slides; name those that turn by `on`"):
        Counterbalance(JOINTS, base_arm=0.5, link_arm=0.2, angle=0.7, free_length=0.4)
