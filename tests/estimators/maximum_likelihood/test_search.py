"""The choice of knots: by white positions, else by the torque, else by nothing."""

import numpy as np
import pytest

from dynident.estimators import Barrier
from dynident.estimators.maximum_likelihood import LikelihoodSearch, NewtonSettings, Recordings, Sigma
from dynident.models.lagrangian import slider
from dynident.motion.log import Log

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


def intervals(found: LikelihoodSearch) -> int:
    found.choose_knots(None, from_rest=False, condense=False)
    (segment,) = found.segments
    return len(segment.trajectory.first_coefficient)


def test_white_positions_decide() -> None:
    """The widest spacing that follows the motion, whatever narrower ones would do."""
    found = search(coloured=False)
    assert intervals(found) == 2000 / 40
    assert found.sigma.q[0] == pytest.approx(1e-4, rel=0.05)


def test_the_torque_decides_where_positions_are_never_white() -> None:
    """Narrow knots follow the noise, wide ones not the motion: both leave more of the torque."""
    narrow = intervals(search(coloured=True))
    assert 2000 / 80 < narrow < 2000 / 5


def test_without_any_torque_there_are_knots_all_the_same() -> None:
    assert intervals(search(coloured=True, used=False)) > 2000 / 80
