"""Where a trajectory comes closest to something."""

import numpy as np
import pytest

from dynident.excitation.nearest import nearest
from dynident.excitation.quintic import Quintic, at_rest
from dynident.excitation.trajectory import Piece, Purpose, Trajectory

TRAJECTORY = Trajectory(("a",), (Piece(Quintic(4.0, at_rest(np.array([0.0])), at_rest(np.array([5.0]))), Purpose.WAY),))


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
    found = nearest(thorn, TRAJECTORY, 0.025)
    assert found.distance == pytest.approx(0.02, abs=2e-4)
    assert found.pair == ("link", "thorn")
    assert TRAJECTORY.states(np.array([found.time]))[0, 0, 0] == pytest.approx(place, abs=1e-3)
    assert thorn.asked < 1500  # not all of 4000


def test_with_nothing_to_watch_nothing_is_near():
    class Nothing:
        pairs = ()

        def distances(self, q):
            return np.empty((len(q), 0))

    assert nearest(Nothing(), TRAJECTORY, 0.1) is None
