"""A model as a simulation has it: which friction is set apart."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.models.friction import Coulomb, Power, Stribeck, Viscous
from dynident.models.lagrangian import pendulum
from dynident.models.simulation.trace import Machine

JOINTS = pendulum().joints


def test_only_friction_of_a_constant_size_or_slope_is_separated() -> None:
    """A power of the speed, viscous by its role, and the Stribeck effect stay in the model."""
    terms = Viscous(JOINTS), Coulomb(JOINTS), Power(JOINTS, exponent=0.5), Stribeck(JOINTS, velocity=0.1)
    machine = Machine(pendulum().with_terms(*terms), (0.1, 0.2, 1.0, 2.0, 4.0, 8.0))
    assert machine.V.tolist() == [[1.0]]
    assert machine.F.tolist() == [2.0]
    slow, fast = (machine.mass_and_bias(np.zeros((1, 1)), np.full((1, 1), v))[1].item() for v in (0.1, 4.0))
    assert (slow, fast) == pytest.approx((4.0 * 0.1**0.5 + 8.0 * np.exp(-1), 8.0))
