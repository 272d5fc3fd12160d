"""The choice of knots by white positions, else by the torque; intervals from the profile of the likelihood."""

import numpy as np
import pytest

from dynident.estimators import Barrier
from dynident.estimators.maximum_likelihood import LikelihoodSearch, NewtonSettings, Recordings, Sigma
from dynident.estimators.maximum_likelihood.plan import crossing, sweep_intervals
from dynident.models.lagrangian import slider
from dynident.motion.log import Log
from dynident.motion.splines import NORMAL_95

THETA = np.array([2.0, 1.0, 0.5, 0.1])


def search(*, coloured: bool, used: bool = True) -> LikelihoodSearch:
    """A slider at 200 Hz; its position noise is white, or nearly the same from sample to sample."""
    rng, t, model = np.random.default_rng(0), np.arange(2000) / 200, slider()
    q, dq, ddq = (a * np.sin(2 * t + phase)[:, None] for a, phase in ((1, 0), (2, np.pi / 2), (-4, 0)))
    noise = rng.standard_normal(q.shape)
    if coloured:
        for k in range(1, len(noise)):
            noise[k] = 0.9 * noise[k - 1] + 0.44 * noise[k]
    tau = model.torque(q, dq, ddq, THETA) + 0.05 * rng.standard_normal(q.shape)
    log = Log(t, q + 1e-4 * noise, tau, ("slider",))
    given = Recordings((log,), ((),), (np.full(q.shape, used),), 0.0, np.array([28.0]))
    sigma = Sigma(np.array([1e-4]), np.array([0.05]))
    return LikelihoodSearch(model, given, Barrier(), NewtonSettings(), np.eye(4), THETA, sigma)


def intervals(result: LikelihoodSearch) -> int:
    result.choose_knots(None, from_rest=False, condense=False)
    (segment,) = result.segments
    return len(segment.trajectory.first_coefficient)


def test_white_positions_decide() -> None:
    """The widest spacing that follows the motion, whatever narrower ones would do."""
    outcome = search(coloured=False)
    assert intervals(outcome) == 2000 / 40
    assert outcome.sigma.q[0] == pytest.approx(1e-4, rel=0.05)


def test_the_torque_decides_where_positions_are_never_white() -> None:
    """Narrow knots follow the noise, wide ones not the motion: both leave more of the torque."""
    narrow = intervals(search(coloured=True))
    assert 2000 / 80 < narrow < 2000 / 5


class TestProfile:
    @pytest.mark.parametrize("size", [0.1, 0.4])
    def test_a_parabola_ends_where_it_should(self, size: float) -> None:
        ends = [crossing(lambda y: ((y - 1) / size, 1 / size), size, side) for side in (-1, 1)]
        assert ends == pytest.approx([1 - NORMAL_95 * size, 1 + NORMAL_95 * size], rel=1e-3)

    def test_what_physics_ends(self) -> None:
        """The end is not beyond where trials fail."""
        failed = []

        def root(y: float) -> tuple[float, float]:
            if 0.8 < y < 1.4:
                return (y - 1) / 0.5, 2.0
            failed.append(y)
            return np.nan, np.nan

        assert 1.3 < crossing(root, 0.5, 1) <= min(failed)
        failed.clear()
        assert max(failed, default=0.0) <= crossing(root, 0.5, -1) < 0.9

    @pytest.mark.parametrize("side", [-1, 1])
    def test_a_deviance_that_falls_again_before_it_rises(self, side: int) -> None:
        """Where it falls there is no slope to go by."""
        first = []

        def root(y: float) -> tuple[float, float]:
            first.append(y)
            return (side * 0.5, -1.0) if len(first) == 1 else (side * 3.0, 2.0)

        result = crossing(root, 0.4, side)
        assert min(first[:2]) < result < max(first[:2])

    def test_swept_intervals_bend_with_the_valley(self) -> None:
        covariance = np.array([[1.0, 1.0], [1.0, 1.0]])
        path = [(r, np.array([r, r + 0.1 * r**2])) for r in (-1.5, 2.5)]
        result = sweep_intervals(np.zeros(2), path, covariance, 0)
        expected = [[-NORMAL_95, NORMAL_95], [-NORMAL_95 + 0.1 * NORMAL_95**2, NORMAL_95 + 0.1 * NORMAL_95**2]]
        np.testing.assert_allclose(result, expected, rtol=1e-9)
