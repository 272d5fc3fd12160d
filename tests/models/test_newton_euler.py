"""Torque and regressor in the axes of the bodies are those that Pinocchio has, joint by joint of the bodies."""

import numpy as np
import pytest

from dynident.models import RigidBodies
from dynident.models.tree import NewtonEuler
from tests.models.judge import Judge, assert_same, random_bodies, random_states, recursion_of
from tests.robots import joint, link, urdf


def of(bodies):
    tree = recursion_of(bodies).tree
    return NewtonEuler(tree, np.array(bodies.gravity)), tree.layout


def rows(layout, states):
    return [np.ascontiguousarray(one.T) for one in layout.body_states(*states)]


@pytest.mark.parametrize("kinds", [("revolute",), ("prismatic",), ("revolute", "prismatic")])
def test_columns_of_some_parameters_are_those_of_all(kinds):
    bodies, theta = random_bodies(11, 5, kinds, mimics=0.0)
    mine, layout = of(bodies)
    states = random_states(bodies, 12, 4)
    Y = Judge(bodies, theta).regressor(*states)
    chains = {chain.body: chain for chain in layout.chains}
    for roles in ([0], [0, 2, 7], [1, 3], [4, 9], list(range(10))):
        for _, body, found in mine.columns(rows(layout, states), dict.fromkeys(chains, np.array(roles))):
            chain = chains[body]
            expected = Y[:, chain.joints][:, :, 10 * chain.place + np.array(roles)].transpose(2, 1, 0)
            assert np.abs(found - expected).max() < 1e-13 * np.abs(Y).max()


def test_only_bodies_that_are_asked_for():
    bodies, _ = random_bodies(13, 4, mimics=0.0)
    mine, layout = of(bodies)
    found = list(mine.columns(rows(layout, random_states(bodies, 14, 3)), {2: np.array([5])}))
    assert [(body, columns.shape[::2]) for _, body, columns in found] == [(2, (1, 3))]


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0.6, 0, -0.8)])
def test_any_axis(axis):
    parts = [link("a"), link("b", 1.0), link("c", 1.0)]
    joints = [
        joint("j", "revolute", "a", "b", (0.1, 0.2, 0.3), (0, 0, 0), axis),
        joint("k", "revolute", "b", "c", (0.3, 0, 0.1), (0.2, 0, 0), axis),
    ]
    bodies = RigidBodies(urdf(*parts, *joints))
    theta = np.random.default_rng(15).normal(size=20)
    states = random_states(bodies, 16, 3)
    mine, layout = of(bodies)
    assert_same(
        mine.torque(rows(layout, states), layout.expand_parameters(theta)).T, Judge(bodies, theta).torque(*states)
    )
