"""Placements of bodies are those of Pinocchio, and points on them move as differences say."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.models import RigidBodies
from dynident.runtime import ModelError
from tests.models.judge import Judge, assert_same, random_bodies, random_states
from tests.robots import ARM, link
from tests.robots import joint as joint_of

few = settings(max_examples=20, deadline=None)


def jacobians(result, body, points):
    """The derivatives (N, P, 3, n) by q of points (N, P, 3) that are fixed to their bodies."""
    return np.stack(
        [result.project_on_joints(body, points, np.broadcast_to(x, points.shape)) for x in np.eye(3)], axis=2
    )


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


@few
@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_points_move_with_their_joints(seed, count):
    bodies, _ = random_bodies(seed, count)
    rng, (q, _, _), h = np.random.default_rng(seed), random_states(bodies, seed, 3), 1e-5
    body, local = rng.integers(-1, count, 6), rng.normal(size=(6, 3))
    result = bodies.placements(q)
    points = result.points(body, local)
    J = jacobians(result, body, points)
    for k in range(q.shape[1]):
        step = h * np.eye(q.shape[1])[k]
        ahead, behind = (bodies.placements(x).points(body, local) for x in (q + step, q - step))
        assert_same(J[..., k], (ahead - behind) / (2 * h), 1e-8)
    along = rng.normal(size=points.shape)
    assert_same(result.project_on_joints(body, points, along), np.einsum("ipck,ipc->ipk", J, along))


def test_the_base_stands_where_the_file_says():
    mount = link("ground") + joint_of("mount", "fixed", "ground", "base", (0.5, -1.0, 2.0))
    far, near = RigidBodies(ARM.replace("</robot>", f"{mount}</robot>")), RigidBodies(ARM)
    q = np.ones((1, 3))
    assert_same(far.placements(q).origins, near.placements(q).origins + np.array([0.5, -1.0, 2.0]))


def test_a_wrong_shape_is_an_error():
    with pytest.raises(ModelError, match=r"q has the shape \(2, 2\), expected \(N, 3\)"):
        RigidBodies(ARM).placements(np.ones((2, 2)))
