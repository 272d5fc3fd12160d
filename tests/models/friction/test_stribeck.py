"""The Stribeck effect."""

import numpy as np

from dynident.models import Joint
from dynident.models.friction import Stribeck

JOINTS = (Joint("base"),)


def test_it_falls_to_1_e_at_its_velocity_and_is_gone_far_above():
    dq = np.array([[0.0], [1e-9], [0.2], [-0.2], [10.0]])
    column = Stribeck(JOINTS, velocity=0.2).regressor(dq, dq, dq)[:, 0, 0]
    np.testing.assert_allclose(column, [0.0, 1.0, np.exp(-1), -np.exp(-1), 0.0], atol=1e-15)


def test_it_is_smooth_with_a_width():
    dq = np.array([[0.1]])
    column = Stribeck(JOINTS, velocity=0.2, width=0.1).regressor(dq, dq, dq)
    np.testing.assert_allclose(column, np.exp(-0.25) * np.tanh(1.0), rtol=1e-15)
