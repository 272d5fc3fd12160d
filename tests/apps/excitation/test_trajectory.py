"""Pieces one after the other, at a share of their speed, and where they come closest to something."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from dynident.apps.excitation import Piece, Purpose, Trajectory
from dynident.apps.excitation.trajectory import closest_approach
from dynident.apps.excitation.way import Quintic, rest_state


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


def test_times_are_at_the_rate_with_the_end():
    assert TWO.times(2.0).tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    assert TWO.times(1.0).tolist() == [0.0, 1.0, 2.0, 2.5]
    assert len(TWO.times(1000.0)) == 2501


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


def test_with_nothing_to_watch_nothing_is_near():
    assert closest_approach(SimpleNamespace(pairs=()), TRAJECTORY, 0.1) is None


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


def test_what_stays_near_all_the_time_does_not_cost_much():
    beside = Comb(0.0, 0.0)
    beside.distances = lambda q: Thorn.distances(beside, q) * 0.0 + 0.02
    assert closest_approach(beside, TRAJECTORY, 0.01).distance == 0.02
    assert beside.asked < 8000
