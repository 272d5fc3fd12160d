"""A trajectory at a share of its speed: the same path, with derivatives that belong to it."""

import numpy as np
import pytest

from dynident.apps.excitation import Piece, Purpose, Trajectory, slow_down
from dynident.apps.excitation.family import Fourier
from dynident.runtime import ConfigError


def test_the_path_is_the_same_and_its_derivatives_are_smaller() -> None:
    series = Fourier(2.0, 3)
    x = np.random.default_rng(0).standard_normal((2, series.size))
    fast = Trajectory(("a", "b"), (Piece(series.course(x), Purpose.MOTION, "one"),) * 2)
    slow = slow_down(fast, 4.0)
    t = np.linspace(0.0, fast.duration, 101)
    assert slow.duration == pytest.approx(4 * fast.duration)
    assert [piece.label for piece in slow.pieces] == ["one", "one"]
    expected = fast.states(t) / np.array([1.0, 4.0, 16.0, 64.0])[:, None, None]
    np.testing.assert_allclose(slow.states(4 * t), expected, rtol=1e-9, atol=1e-12)
    h = 1e-4
    ends = slow.states(np.array([3.0 - h, 3.0, 3.0 + h]))
    assert (ends[0, 2] - ends[0, 0]) / (2 * h) == pytest.approx(ends[1, 1], rel=1e-5)


def test_a_motion_is_not_made_faster() -> None:
    with pytest.raises(ConfigError, match="at least 1"):
        slow_down(Trajectory(("a",), (Piece(Fourier(1.0, 1).course(np.ones((1, 3))), Purpose.MOTION),)), 0.5)
