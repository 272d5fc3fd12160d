"""Families of motions, ways between states, pieces one after the other, and where they come closest."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.apps.excitation import MotionLimits, Piece, Purpose, Trajectory, verify
from dynident.apps.excitation.family import ClampedSpline, Fourier, LinearCourse
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.trajectory import closest_approach
from dynident.apps.excitation.way import Quintic, direct_path, feasible_durations, find_path, from_rest, rest_state
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post, scaled, smooth_and_at_rest


@dataclass(frozen=True)
class Line:
    """A course that says which it is, and its own time."""

    duration: float
    number: float

    def states(self, t):
        assert ((t >= 0) & (t <= self.duration)).all()
        return np.stack([np.stack([t, np.full(len(t), self.number)], axis=1)] * 4)


TWO = Trajectory(("a", "b"), (Piece(Line(2.0, 1.0), Purpose.WAY), Piece(Line(0.5, 2.0), Purpose.MOTION)))


def test_each_piece_has_its_own_time_and_the_later_one_counts_where_they_meet():
    assert TWO.duration == 2.5
    assert TWO.edges.tolist() == [0.0, 2.0, 2.5]
    states = TWO.states(np.array([0.0, 2.5, 1.5, -1.0, 2.0, 9.0]))  # in any order; it stands still before and after
    assert states[0].tolist() == [[0.0, 1.0], [0.5, 2.0], [1.5, 1.0], [0.0, 1.0], [0.0, 2.0], [0.5, 2.0]]
    assert not states[1:, [3, 5]].any()
    assert states[1:, [0, 1, 2, 4]].any()
    assert TWO.states(np.empty(0)).shape == (4, 0, 2)


def test_what_repeats_is_left_out_once():
    (way, motion), back = TWO.pieces, Piece(Line(2.0, 3.0), Purpose.WAY)
    full = Trajectory(("a", "b"), (way, motion, motion, motion, back, motion))
    assert full.without_repeats.pieces == (way, motion, back, motion)
    assert TWO.without_repeats.pieces == TWO.pieces
    for t, first in ((1.0, 1.0), (2.3, 2.3), (2.6, 3.6), (4.6, 5.6)):
        assert full.first_time(t) == pytest.approx(first)
        np.testing.assert_allclose(full.states(np.array([first])), full.without_repeats.states(np.array([t])))


TRAJECTORY = Trajectory(
    ("a",), (Piece(Quintic(4.0, rest_state(np.array([0.0])), rest_state(np.array([5.0]))), Purpose.WAY),)
)


class Thorn:
    """Something narrow at a position; it is passed within a few milliseconds. Counts what it is asked."""

    pairs = (("link", "wall"), ("link", "thorn"))

    def __init__(self, place, depth):
        self.place, self.depth, self.asked = place, depth, 0

    def distances(self, q):
        self.asked += len(q)
        thorn = 0.05 - self.depth + np.abs(q[:, 0] - self.place)
        return np.stack([10.0 + q[:, 0], np.minimum(thorn, 0.3)], axis=1)


@pytest.mark.parametrize("place", [0.7123, 2.5, 3.3337])
def test_a_narrow_approach_is_found_between_the_coarse_samples(place):
    thorn = Thorn(place, 0.03)
    result = closest_approach(thorn, TRAJECTORY, 0.025)
    assert result.distance == pytest.approx(0.02, abs=2e-4)
    assert result.pair == ("link", "thorn")
    assert TRAJECTORY.states(np.array([result.time]))[0, 0, 0] == pytest.approx(place, abs=1e-3)
    assert thorn.asked < 1500  # not all of 4000


class Comb(Thorn):
    """A thorn that says how fast it comes, and so narrow that nothing shows it before."""

    steepest = np.array([[1.0], [1.0]])

    def distances(self, q):
        d = super().distances(q)
        d[:, 1] = np.minimum(d[:, 1], 0.03)
        return d


@pytest.mark.parametrize("place", [0.7123, 2.501, 3.3337])
def test_an_approach_is_proven_where_the_slopes_are_known(place):
    comb = Comb(place, 0.0401)
    result = closest_approach(comb, TRAJECTORY, 0.01)
    assert result.distance == pytest.approx(0.0099, abs=2e-5)
    assert result.pair == ("link", "thorn")
    assert comb.asked < 6000


seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("family", [Fourier(7.0, 4), ClampedSpline(7.0, 9)])
def test_each_is_the_derivative_of_the_one_before(family):
    t, h = np.linspace(0.1, 6.9, 50), 1e-5
    slopes = (family.values(t + h) - family.values(t - h))[:3] / (2 * h)
    np.testing.assert_allclose(slopes, family.values(t)[1:], atol=1e-5 * np.abs(slopes).max())


@given(seeds, st.integers(1, 8), st.floats(1.05, 12.0))
@settings(max_examples=40)
def test_what_is_within_the_share_on_the_grid_is_within_the_limits_everywhere(seed, harmonics, density):
    family, rng = Fourier(7.0, harmonics), np.random.default_rng(seed)
    guard = family.guard(int(np.ceil(2 * harmonics * density)) + 1)
    fine = family.values(np.linspace(0, 7.0, 1500))
    x = rng.normal(size=family.size) * rng.uniform(0, 1, family.size) ** 3
    for d in range(4):
        middle = float(rng.normal())
        half = np.abs(guard.rows[d] @ x - middle).max() / guard.share
        assert np.abs(fine[d] @ x - middle).max() <= half * (1 + 1e-12)


def test_a_pure_cosine_between_the_points_reaches_the_bound():
    family = Fourier(1.0, 3)
    guard = family.guard(12)
    x = np.zeros(7)
    x[5], x[6] = 3 * np.sin(3 * np.pi / 12), 3 * np.cos(3 * np.pi / 12)  # largest half a step after 0
    on_grid = np.abs(guard.rows[0] @ x).max()
    assert on_grid == pytest.approx(guard.share)
    assert np.abs(family.values(np.array([1 / 24]))[0] @ x)[0] == pytest.approx(1.0)


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


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_way_goes_around_what_is_between(seed):
    assert direct_path(AROUND, rest_state(LOW), rest_state(HIGH)) is None
    path = find_path(AROUND, LOW, HIGH, np.random.default_rng(seed))
    assert len(path) > 1
    trajectory = Trajectory(LIMITS.joints, path)
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
