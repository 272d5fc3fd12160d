"""The recursion by NumPy is what Pinocchio says, for any tree."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.models import recursion
from tests.models.judge import Judge, assert_same, random_bodies, random_states, recursion_of

few = settings(max_examples=30, deadline=None)
seeds, sizes = st.integers(0, 2**32 - 1), st.integers(1, 12)


def full(bodies, theta):
    return recursion_of(bodies).layout.expand_parameters(theta)


@few
@given(seeds, sizes)
def test_any_tree_has_the_dynamics_of_pinocchio(seed, count):
    bodies, theta = random_bodies(seed, count)
    state, judge = random_states(bodies, seed, 5), Judge(bodies, theta)
    mine, values = recursion_of(bodies), full(bodies, theta)
    Y = judge.regressor(*state)
    assert_same(mine.regressor(*state), Y)
    assert_same(mine.torque(*state, values), judge.torque(*state))
    for result, expected in zip(mine.partials(*state, values), judge.partials(*state), strict=True):
        assert_same(result, expected)
    mass, bias = mine.mass_and_bias(*state[:2], values)
    assert_same(mass, judge.mass(state[0]))
    assert_same(bias, judge.torque(*state[:2], 0 * state[0]))
    joint, parameter = np.nonzero(mine.layout.support)
    assert_same(mine.entries(*state, joint, parameter), Y[:, joint, parameter].T)
    assert np.abs(Y[:, ~mine.layout.support]).max(initial=0.0) < 1e-13 * np.abs(Y).max()


@settings(max_examples=15, deadline=None)
@given(seeds, sizes)
def test_weighted_sums_change_as_the_torques(seed, count):
    """Of each joint by its own row of weights."""
    bodies, _ = random_bodies(seed, count)
    state, mine = random_states(bodies, seed, 3), recursion_of(bodies)
    weights = np.random.default_rng(seed).normal(size=mine.regressor(*state).shape)
    expected = np.zeros((3, *state[0].shape))
    for joint in range(weights.shape[1]):
        for i, case in enumerate(full(bodies, row) for row in weights[:, joint]):
            expected[:, i] += mine.partials(*(x[i : i + 1] for x in state), case)[:, 0, joint]
    assert_same(mine.weighted_gradient(*state, weights), expected)


def test_samples_in_parts_are_the_same(monkeypatch):
    bodies, theta = random_bodies(8, 5)
    state, mine, values = random_states(bodies, 9, 23), recursion_of(bodies), full(bodies, theta)
    total = mine.regressor(*state), mine.torque(*state, values), mine.partials(*state, values)
    slope = mine.weighted_gradient(*state, total[0])
    monkeypatch.setattr(recursion, "AT_ONCE", 20)
    assert_same(mine.regressor(*state), total[0], 1e-15)
    assert_same(mine.torque(*state, values), total[1], 1e-15)
    assert_same(mine.partials(*state, values), total[2], 1e-15)
    assert_same(mine.weighted_gradient(*state, total[0]), slope, 1e-15)
