"""How slow a joint may be, by its friction."""

import numpy as np
import pytest

from dynident.excitation.trajectories.dry_friction import slowest
from dynident.models import Coulomb, Model
from tests.excitation.arms import LIMITS, MODEL


@pytest.mark.parametrize("width", [0.0, 0.05])
def test_only_dry_friction_holds_a_joint(width):
    np.testing.assert_allclose(slowest(MODEL, LIMITS), 0.03 * LIMITS.velocity)
    bodies, *_ = MODEL.terms
    one = Model((bodies, Coulomb(bodies.joints, on=("bend",), width=width)), name="x")
    np.testing.assert_allclose(slowest(one, LIMITS), [0.0, 0.03 * LIMITS.velocity[1]])
    np.testing.assert_array_equal(slowest(Model((bodies,), name="x"), LIMITS), 0.0)
