"""Friction by the load is that without it, times the load."""

import numpy as np
import pytest

from dynident.models import Joint, Past
from dynident.models.friction import Coulomb, Dahl, LoadCoulomb, LoadDahl, LoadViscous, Viscous
from dynident.testing.term import make_past

JOINTS = (Joint("a"), Joint("rail", "prismatic"))
PAST = make_past(2)


@pytest.mark.parametrize(
    ("term", "plain"),
    [
        (LoadCoulomb(JOINTS), Coulomb(JOINTS)),
        (LoadCoulomb(JOINTS, width=0.3), Coulomb(JOINTS, width=0.3)),
        (LoadViscous(JOINTS), Viscous(JOINTS)),
        (LoadDahl(JOINTS, length=0.02), Dahl(JOINTS, length=0.02)),
    ],
)
def test_it_is_friction_times_the_load(term, plain):
    states = PAST.q, PAST.dq, PAST.ddq
    memory = [one.remember(PAST) if hasattr(one, "remember") else None for one in (term, plain)]
    found, expected = (
        one.regressor(*states, *([] if m is None else [m])) for one, m in zip((term, plain), memory, strict=True)
    )
    np.testing.assert_allclose(found, expected * np.abs(PAST.load)[:, :, None], rtol=1e-12)


def test_units_are_those_of_torque_per_torque():
    assert [one.unit for one in LoadCoulomb(JOINTS).parameters] == ["1", "1"]
    assert [one.unit for one in LoadViscous(JOINTS).parameters] == ["s/rad", "s/m"]
    assert {one.role for one in LoadDahl(JOINTS).parameters} == {"coulomb"}


def test_only_the_joints_it_is_on_are_remembered():
    term = LoadCoulomb(JOINTS, on=("rail",))
    past = Past(PAST.t, PAST.q, PAST.dq, PAST.ddq, PAST.load)
    np.testing.assert_array_equal(term.remember(past), PAST.load[:, 1:])
