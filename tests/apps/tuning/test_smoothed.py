"""One joint of a log to be looked at."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.apps.tuning import Bench
from dynident.apps.tuning.curve import MIN_DEGREE, degree_of
from tests.apps.tuning.arms import JOINTS, RATE


def test_the_residual_of_the_right_smoothing_is_white_of_the_noise(arm: Bench) -> None:
    found = arm.smooth(arm.start.with_degree(0.0), "log 1", JOINTS[0])
    assert found.degree == pytest.approx(0.0, abs=1e-6)
    assert found.noise == pytest.approx(2e-4, rel=0.05)
    np.testing.assert_allclose(found.residual, found.measured - found.q)
    f, power = found.spectrum()
    assert (f[0] > 0, f[-1]) == (True, pytest.approx(RATE / 2, rel=0.01))
    high = power[f > 4 * found.cutoff]
    assert high.mean() == pytest.approx(2 * 2e-4**2 / RATE, rel=0.15)
    late, auto, bound = found.autocorrelation()
    assert late[0] == pytest.approx(1 / RATE)
    assert np.abs(auto[50:]).mean() < bound
    assert 2 < found.edf < len(found.t)


def test_too_much_smoothing_leaves_the_motion_in_the_residual(arm: Bench) -> None:
    found = arm.smooth(arm.start.with_degree(2.0), "log 1", JOINTS[0])
    f, power = found.spectrum()
    assert power[f < 5].max() > 30 * np.median(power)
    _, auto, bound = found.autocorrelation()
    assert auto[0] > 5 * bound


def test_no_noise_has_no_degree() -> None:
    assert degree_of(np.zeros(5), 1e-3) == MIN_DEGREE
    assert degree_of(np.ones(5), 0.0) == MIN_DEGREE
    assert degree_of(np.full(5, 0.1), 0.1) == pytest.approx(0.0)
