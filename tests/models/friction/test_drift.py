"""Drift begins with the recording."""

import numpy as np

from dynident.models import Joint, Past
from dynident.models.friction import Drift


def test_most_of_it_is_over_after_its_time():
    t = np.array([100.0, 110.0, 120.0, 1000.0])
    still = np.zeros((4, 1))
    found = Drift((Joint("a"),), time=10.0).remember(Past(t, still, still, still, still))
    np.testing.assert_allclose(found[:, 0], 1.0 - np.exp([0.0, -1.0, -2.0, -90.0]))
