"""Pieces one after the other."""

from dataclasses import dataclass

import numpy as np
import pytest

from dynident.apps.excitation import Piece, Purpose, Trajectory
from dynident.runtime import ConfigError


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
    states = TWO.states(np.array([0.0, 1.5, 2.0, 2.5]))
    assert states[0].tolist() == [[0.0, 1.0], [1.5, 1.0], [0.0, 2.0], [0.5, 2.0]]


def test_before_and_after_it_stands_still():
    states = TWO.states(np.array([-1.0, 9.0]))
    assert states[0].tolist() == [[0.0, 1.0], [0.5, 2.0]]
    assert not states[1:].any()


def test_times_are_at_the_rate_with_the_end():
    assert TWO.times(2.0).tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    assert TWO.times(1.0).tolist() == [0.0, 1.0, 2.0, 2.5]
    assert len(TWO.times(1000.0)) == 2501


def test_what_repeats_is_left_out_once():
    (way, motion), back = TWO.pieces, Piece(Line(2.0, 3.0), Purpose.WAY)
    whole = Trajectory(("a", "b"), (way, motion, motion, motion, back, motion))
    assert whole.without_repeats.pieces == (way, motion, back, motion)
    assert TWO.without_repeats.pieces == TWO.pieces
    for t, first in ((1.0, 1.0), (2.3, 2.3), (2.6, 3.6), (4.6, 5.6)):
        assert whole.first_time(t) == pytest.approx(first)
        np.testing.assert_allclose(whole.states(np.array([first])), whole.without_repeats.states(np.array([t])))


def test_times_of_any_order_have_their_states():
    t = np.array([2.4, 0.3, 2.1, -1.0, 1.0])
    np.testing.assert_array_equal(TWO.states(t)[:, np.argsort(t)], TWO.states(np.sort(t)))
    assert TWO.states(np.empty(0)).shape == (4, 0, 2)


def test_a_trajectory_of_nothing_is_refused():
    with pytest.raises(ConfigError, match="no pieces"):
        Trajectory(("a",), ())
