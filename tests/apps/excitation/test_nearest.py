"""Where a trajectory comes closest to something."""

import numpy as np
import pytest

from dynident.apps.excitation import Piece, Purpose, Trajectory
from dynident.apps.excitation.trajectory import closest_approach
from dynident.apps.excitation.way import Quintic, rest_state

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
    found = closest_approach(thorn, TRAJECTORY, 0.025)
    assert found.distance == pytest.approx(0.02, abs=2e-4)
    assert found.pair == ("link", "thorn")
    assert TRAJECTORY.states(np.array([found.time]))[0, 0, 0] == pytest.approx(place, abs=1e-3)
    assert thorn.asked < 1500  # not all of 4000


def test_with_nothing_to_watch_nothing_is_near():
    class Nothing:
        pairs = ()

        def distances(self, q):
            return np.empty((len(q), 0))

    assert closest_approach(Nothing(), TRAJECTORY, 0.1) is None


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
    found = closest_approach(comb, TRAJECTORY, 0.01)
    assert found.distance == pytest.approx(0.0099, abs=2e-5)
    assert found.pair == ("link", "thorn")
    assert comb.asked < 6000


def test_what_stays_near_all_the_time_does_not_cost_much():
    class Beside:
        pairs = (("link", "wall"),)
        steepest = np.array([[1.0]])
        asked = 0

        def distances(self, q):
            self.asked += len(q)
            return np.full((len(q), 1), 0.02)

    beside = Beside()
    assert closest_approach(beside, TRAJECTORY, 0.01).distance == 0.02
    assert beside.asked < 8000
