"""A line at constant speed, with limited acceleration and jerk."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.apps.excitation.trajectory import Hold, Sweep, ramp_times

rooms, sizes = st.floats(0.0, 5.0), st.floats(0.5, 50.0)


@given(st.floats(0.01, 5.0), sizes, st.floats(1.0, 5000.0), rooms, st.sampled_from([-1.0, 1.0]))
def test_a_sweep_keeps_its_limits_and_ends_at_rest_where_it_should(speed, acceleration, jerk, extra, sign):
    ramp, full = ramp_times(speed, acceleration, jerk)
    distance = sign * (speed * (2 * ramp + full) + extra)
    sweep = Sweep(np.array([0.5, -1.0]), np.array([0.0, 1.0]), distance, speed, acceleration, jerk)
    t = np.linspace(0, sweep.duration, 999)
    q, dq, ddq, jerks = sweep.states(t)
    assert (q[:, 0] == 0.5).all()
    assert not dq[:, 0].any()
    assert np.abs(dq).max() == pytest.approx(speed)
    assert np.abs(ddq).max() <= acceleration * (1 + 1e-9)
    assert np.abs(jerks).max() <= jerk
    np.testing.assert_allclose([q[0, 1], q[-1, 1], dq[-1, 1]], [-1.0, -1.0 + distance, 0.0], atol=1e-8)
    assert np.abs(ddq[-1]).max() <= 1e-9 * jerk * sweep.duration + 1e-9
    np.testing.assert_allclose(sweep.end, q[-1], atol=1e-9)
    assert sweep.cruise == pytest.approx(extra / speed, abs=1e-9 * sweep.duration + 1e-12)


def test_each_is_the_derivative_of_the_one_before():
    sweep = Sweep(np.zeros(2), np.array([1.0, -0.3]), 2.0, 1.0, 4.0, 60.0)
    t, h = np.linspace(0.01, sweep.duration - 0.01, 57), 1e-6
    slope = (sweep.states(t + h) - sweep.states(t - h))[:3] / (2 * h)
    np.testing.assert_allclose(slope, sweep.states(t)[1:], atol=1e-4)


def test_an_arm_that_holds_stands():
    q, *rest = Hold(2.0, np.array([1.0, 2.0])).states(np.array([0.0, 1.0]))
    assert q.tolist() == [[1.0, 2.0]] * 2
    assert not np.any(rest)
