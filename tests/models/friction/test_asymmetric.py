"""Friction that differs between the directions."""

import numpy as np

from dynident.models import Joint, Model
from dynident.models.friction import AsymmetricCoulomb, AsymmetricViscous, Coulomb, Viscous

JOINTS = (Joint("base"), Joint("rail", "prismatic"))


def test_friction_of_both_directions():
    model = Model((Coulomb(JOINTS), AsymmetricCoulomb(JOINTS, width=0.01), Viscous(JOINTS), AsymmetricViscous(JOINTS)))
    dq = np.array([[1.0, 2.0], [-1.0, -2.0]])
    tau = model.torque(dq, dq, dq, [3.0, 0.0, 0.5, 0.0, 10.0, 1.0, 2.0, 1.0])
    np.testing.assert_allclose(tau, [[3.5 + 12.0, 4.0], [-2.5 - 8.0, 0.0]], rtol=1e-14)


def test_units_are_those_of_viscous_friction():
    assert [one.unit for one in AsymmetricViscous(JOINTS).parameters] == ["N m s/rad", "N s/m"]


def test_it_is_continuous_at_rest():
    still = np.zeros((1, 2))
    assert not AsymmetricCoulomb(JOINTS, width=0.01).regressor(still, still, still).any()
    assert not AsymmetricViscous(JOINTS).partials(still, still, still, np.ones(2)).dq.any()
