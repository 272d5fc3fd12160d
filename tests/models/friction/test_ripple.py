"""Ripple."""

import numpy as np

from dynident.models import Joint
from dynident.models.friction import Ripple

JOINTS = (Joint("base"), Joint("wrist"))


def test_it_repeats_with_the_position():
    q = np.random.default_rng(0).uniform(-3, 3, (10, 2))
    term = Ripple(JOINTS, cycles=(12, 36))
    shifted = term.regressor(q + 2 * np.pi / 12, q, q)
    np.testing.assert_allclose(shifted, term.regressor(q, q, q), atol=1e-12)


def test_a_delay_is_that_of_the_torque_in_time():
    t, delay = np.linspace(0, 1, 50)[:, None], np.array([0.002, -0.003])
    q, dq = np.sin(3 * t) * [1.0, 0.5], 3 * np.cos(3 * t) * [1.0, 0.5]
    before = np.sin(3 * (t - delay)) * [1.0, 0.5]
    term = Ripple(JOINTS, cycles=40, delay={"base": 0.002, "wrist": -0.003})
    late, none = term.regressor(q, dq, 0 * q), Ripple(JOINTS, cycles=40)
    np.testing.assert_allclose(late, none.regressor(before, dq, 0 * q), atol=40 * 9 * 0.003**2 / 2)
    assert np.abs(late - none.regressor(q, dq, 0 * q)).max() > 0.2
