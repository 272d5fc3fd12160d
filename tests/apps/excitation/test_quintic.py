"""Ways between two states: they meet both, keep the limits at all times, and take no longer than they must."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.apps.excitation import MotionLimits
from dynident.apps.excitation.way import Quintic, feasible_durations, quintic_bounds, rest_state

seeds = st.integers(0, 2**32 - 1)
sizes = {"velocity": 2.0, "acceleration": 8.0, "jerk": 160.0, "torque": np.inf}
LIMITS = MotionLimits(
    ("a", "b"), np.full(2, -2.0), np.full(2, 1.5), **{k: np.full(2, v) for k, v in sizes.items()}, by_rule={}, beyond={}
)


@given(seeds, st.floats(0.1, 20.0))
def test_a_quintic_meets_both_states_and_its_derivatives_follow(seed, duration):
    start, end = np.random.default_rng(seed).normal(size=(2, 3, 2))
    course = Quintic(duration, start, end)
    both = course.states(np.array([0.0, duration]))
    scale = duration ** np.arange(3.0)[:, None]
    np.testing.assert_allclose(both[:3, 0] * scale, start * scale, atol=1e-9 * (1 + duration**2))
    np.testing.assert_allclose(both[:3, 1] * scale, end * scale, atol=1e-9 * (1 + duration**2))
    t, h = np.array([0.3, 0.5, 0.8]) * duration, 1e-5 * duration
    slope = (course.states(t + h) - course.states(t - h))[:3] / (2 * h)
    np.testing.assert_allclose(
        slope * duration, course.states(t)[1:] * duration, atol=1e-4 * np.abs(course.states(t)).max()
    )


@given(seeds)
def test_the_reach_holds_at_all_times_and_is_close(seed):
    start, end = np.random.default_rng(seed).normal(size=(2, 3, 2))
    low, high, sizes = quintic_bounds(start, end, np.array([1.7]))
    found = Quintic(1.7, start, end).states(np.linspace(0, 1.7, 3000))
    assert (found[0].min(axis=0) >= low[0] - 1e-12).all()
    assert (found[0].max(axis=0) <= high[0] + 1e-12).all()
    reached = np.abs(found[1:]).max(axis=1)
    assert (reached <= sizes[0] * (1 + 1e-12)).all()
    assert (sizes[0] <= 1.1 * reached).all()


def test_from_rest_to_rest_the_duration_is_the_least_that_the_limits_allow():
    for way in (0.01, 0.3, 3.0):
        start, end = rest_state(np.array([-1.8, 0.0])), rest_state(np.array([-1.8 + way, 0.0]))
        least = max(15 / 8 * way / 2.0, (10 / 3**0.5 * way / 8.0) ** 0.5, (60 * way / 160.0) ** (1 / 3))
        assert least <= next(feasible_durations(LIMITS, start, end)) <= 1.06 * max(least, 0.05)


@given(seeds)
def test_every_duration_offered_keeps_the_limits(seed):
    rng = np.random.default_rng(seed)
    start = rest_state(rng.uniform(-2.0, 1.5, 2))
    end = np.stack([rng.uniform(-2.0, 1.5, 2), rng.uniform(-2, 2, 2), rng.uniform(-8, 8, 2)])
    for duration in list(feasible_durations(LIMITS, start, end))[:4]:
        q, *rest = Quintic(duration, start, end).states(np.linspace(0, duration, 500))
        assert q.min() >= -2.0 - 1e-8
        assert q.max() <= 1.5 + 1e-8
        for found, limit in zip(rest, (2.0, 8.0, 160.0), strict=True):
            assert np.abs(found).max() <= limit * (1 + 1e-8)


def test_a_state_beyond_the_limits_has_no_way():
    outside = rest_state(np.array([1.6, 0.0]))
    assert list(feasible_durations(LIMITS, rest_state(np.zeros(2)), outside)) == []
    assert next(feasible_durations(replace(LIMITS, upper=np.full(2, 1.7)), rest_state(np.zeros(2)), outside)) > 0
    fast = np.array([[0.0, 0.0], [2.1, 0.0], [0.0, 0.0]])
    assert list(feasible_durations(LIMITS, rest_state(np.zeros(2)), fast)) == []


def test_a_way_to_where_one_is_takes_the_shortest_duration():
    pose = rest_state(np.array([0.1, 0.2]))
    assert next(feasible_durations(LIMITS, pose, pose)) == pytest.approx(0.05)
