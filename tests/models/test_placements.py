"""Placements of bodies are those of Pinocchio, and points on them move as differences say."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.models import RigidBodies
from dynident.runtime import ModelError
from tests.models.judge import Judge, assert_same, random_bodies, random_states
from tests.robots import ARM

few = settings(max_examples=20, deadline=None)


@few
@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_any_tree_is_where_pinocchio_says(seed, count):
    bodies, theta = random_bodies(seed, count)
    (q, _, _), judge = random_states(bodies, seed, 3), Judge(bodies, theta)
    result = bodies.placements(q)
    for i, moved in enumerate(bodies.arm.body_states(q, q, q)[0]):
        pin.forwardKinematics(judge.model, judge.data, moved)
        for k, place in enumerate(list(judge.data.oMi)[1:]):
            assert_same(result.rotations[i, k], place.rotation)
            assert_same(result.origins[i, k], place.translation)


def test_a_wrong_shape_is_an_error():
    with pytest.raises(ModelError, match=r"q has the shape \(2, 2\), expected \(N, 3\)"):
        RigidBodies(ARM).placements(np.ones((2, 2)))
