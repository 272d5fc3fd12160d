"""How slow a joint may be, by its friction."""

import numpy as np
import pytest

from dynident.apps.excitation import min_fit_speeds
from dynident.models import Model
from dynident.models.friction import Coulomb
from tests.apps.excitation.arms import LIMITS, MODEL


@pytest.mark.parametrize("width", [0.0, 0.05])
def test_only_dry_friction_holds_a_joint(width):
    np.testing.assert_allclose(min_fit_speeds(MODEL, LIMITS), 0.03 * LIMITS.velocity)
    bodies, *_ = MODEL.terms
    one = Model((bodies, Coulomb(bodies.joints, on=("bend",), width=width)), name="x")
    np.testing.assert_allclose(min_fit_speeds(one, LIMITS), [0.0, 0.03 * LIMITS.velocity[1]])
    np.testing.assert_array_equal(min_fit_speeds(Model((bodies,), name="x"), LIMITS), 0.0)
