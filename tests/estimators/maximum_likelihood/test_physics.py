"""What physics requires of the parameters of a likelihood."""

import numpy as np

from dynident.estimators.constraints import Barrier
from dynident.estimators.maximum_likelihood import (
    psd_constraints,
)
from dynident.models.gallery import two_link_arm
from dynident.studies import SCENARIOS


class TestPhysics:
    def test_the_articles_arm(self) -> None:
        arm = two_link_arm()
        log = SCENARIOS["stated"].record(1e-8, np.random.default_rng(0)).log
        barrier = Barrier(psd_constraints(arm, [log], np.asarray(arm.values)))
        assert barrier.inside(np.asarray(arm.values))
        for k, value in ((0, -1e-2), (1, -1e-3), (5, -0.1), (6, -0.1)):
            theta = np.array(arm.values)
            theta[k] = value
            assert not barrier.inside(theta), arm.names[k]
