"""Ways between states and poses: they meet both ends, keep all limits, and go around what is in the way."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.apps.excitation import MotionLimits, Piece, Purpose, Trajectory, verify
from dynident.apps.excitation.family import Fourier, LinearCourse
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.way import Quintic, direct_path, feasible_durations, find_path, from_rest, rest_state
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post, scaled, smooth_and_at_rest

seeds = st.integers(0, 2**32 - 1)
SIZES = {"velocity": 2.0, "acceleration": 8.0, "jerk": 160.0, "torque": np.inf}
BOX = MotionLimits(
    ("a", "b"), np.full(2, -2.0), np.full(2, 1.5), **{k: np.full(2, v) for k, v in SIZES.items()}, by_rule={}, beyond={}
)


def test_from_rest_to_rest_the_duration_is_the_least_that_the_limits_allow():
    for way in (0.01, 0.3, 3.0):
        start, end = rest_state(np.array([-1.8, 0.0])), rest_state(np.array([-1.8 + way, 0.0]))
        least = max(15 / 8 * way / 2.0, (10 / 3**0.5 * way / 8.0) ** 0.5, (60 * way / 160.0) ** (1 / 3))
        assert least <= next(feasible_durations(BOX, start, end)) <= 1.06 * max(least, 0.05)
    assert next(feasible_durations(BOX, start, start)) == pytest.approx(0.05)


@given(seeds)
@settings(max_examples=40)
def test_every_duration_offered_keeps_the_limits(seed):
    rng = np.random.default_rng(seed)
    start = rest_state(rng.uniform(-2.0, 1.5, 2))
    end = np.stack([rng.uniform(-2.0, 1.5, 2), rng.uniform(-2, 2, 2), rng.uniform(-8, 8, 2)])
    for duration in list(feasible_durations(BOX, start, end))[:4]:
        q, *rest = Quintic(duration, start, end).states(np.linspace(0, duration, 500))
        assert q.min() >= -2.0 - 1e-8
        assert q.max() <= 1.5 + 1e-8
        for result, limit in zip(rest, (2.0, 8.0, 160.0), strict=True):
            assert np.abs(result).max() <= limit * (1 + 1e-8)


def test_a_state_beyond_the_limits_has_no_way():
    outside = rest_state(np.array([1.6, 0.0]))
    assert list(feasible_durations(BOX, rest_state(np.zeros(2)), outside)) == []
    assert next(feasible_durations(replace(BOX, upper=np.full(2, 1.7)), rest_state(np.zeros(2)), outside)) > 0
    fast = np.array([[0.0, 0.0], [2.1, 0.0], [0.0, 0.0]])
    assert list(feasible_durations(BOX, rest_state(np.zeros(2)), fast)) == []


@pytest.mark.parametrize("seed", range(5))
def test_a_series_begins_and_ends_at_rest_at_the_phase_of_its_ramps(seed):
    rng, family = np.random.default_rng(seed), Fourier(6.0, 4)
    x, start = scaled(family, rng, share=0.6), None if seed % 2 else np.array([0.3, -0.4])
    pieces = from_rest(FREE, LinearCourse(family, x), 1, start, rng)
    trajectory = Trajectory(LIMITS.joints, pieces)
    first, last = smooth_and_at_rest(trajectory)
    np.testing.assert_allclose([first, last], [first if start is None else start] * 2, atol=1e-9)
    verify(trajectory, FREE)
    (course,) = (piece.course for piece in pieces if piece.purpose is Purpose.MOTION)
    path = LinearCourse(family, x).states(np.linspace(0, 6.0, 601))[0]
    assert np.abs(path - course.states(np.array([0.0]))[0]).max(axis=1).min() < 0.02
    np.testing.assert_allclose(np.hypot(course.x[:, 1::2], course.x[:, 2::2]), np.hypot(x[:, 1::2], x[:, 2::2]))


def test_without_a_way_there_is_no_motion():
    rng, family = np.random.default_rng(2), Fourier(6.0, 4)
    inside = np.zeros(2)  # of the post
    assert from_rest(AROUND, LinearCourse(family, 0.1 * scaled(family, rng)), 1, inside, rng) is None
    fast = scaled(family, rng, share=5.0)
    assert from_rest(FREE, LinearCourse(family, fast), 1, None, rng) is None or pytest.fail("beyond the limits")


LOW, HIGH = np.array([-0.6, 0.0]), np.array([0.6, 0.0])


def test_a_free_way_is_one_quintic():
    (course,) = find_path(FREE, LOW, HIGH, np.random.default_rng(0))
    assert course.states(np.array([0.0, course.duration]))[0].tolist() == pytest.approx(np.array([LOW, HIGH]))
    assert find_path(FREE, LOW, LOW, np.random.default_rng(0)) == ()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_way_goes_around_what_is_between(seed):
    assert direct_path(AROUND, rest_state(LOW), rest_state(HIGH)) is None
    path = find_path(AROUND, LOW, HIGH, np.random.default_rng(seed))
    assert len(path) > 1
    trajectory = Trajectory(LIMITS.joints, tuple(Piece(x, Purpose.WAY) for x in path))
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
    # the first joint cannot pass zero
    wall = SimpleNamespace(pairs=(("upper", "wall"),), distances=lambda q: np.abs(q[:, :1]) - 0.2)
    walls = replace(AROUND, space=wall)
    assert walls.can_stand(np.stack([LOW, HIGH])).all()
    assert find_path(walls, LOW, HIGH, rng) is None
