"""Terms of single joints."""

import numpy as np
import pytest

from dynident.models import Joint
from dynident.models.friction import Coulomb, Offset, Viscous

JOINTS = (Joint("base"), Joint("rail", "prismatic"), Joint("wrist"))
DQ = np.array([[1.0, -2.0, 0.5], [0.0, 1e-4, -3.0]])


def regressor(term):
    return term.regressor(np.zeros_like(DQ), DQ, np.zeros_like(DQ))


@pytest.mark.parametrize(("kind", "diagonal"), [(Viscous, DQ), (Coulomb, np.sign(DQ)), (Offset, np.ones_like(DQ))])
def test_each_joint_has_its_own_column(kind, diagonal):
    np.testing.assert_array_equal(regressor(kind(JOINTS)), diagonal[:, :, None] * np.eye(3))


@pytest.mark.parametrize(
    ("kind", "prefix", "units"),
    [
        (Viscous, "Fv", ["N m s/rad", "N s/m", "N m s/rad"]),
        (Coulomb, "Fc", ["N m", "N", "N m"]),
        (Offset, "offset", ["N m", "N", "N m"]),
    ],
)
def test_names_and_units_follow_the_joints(kind, prefix, units):
    parameters = kind(JOINTS).parameters
    assert [p.name for p in parameters] == [f"{prefix}_base", f"{prefix}_rail", f"{prefix}_wrist"]
    assert [p.unit for p in parameters] == units


def test_a_subset_in_its_own_order():
    term = Viscous(JOINTS, on=("wrist", "base"))
    assert [p.name for p in term.parameters] == ["Fv_wrist", "Fv_base"]
    expected = np.zeros((2, 3, 2))
    expected[:, 2, 0], expected[:, 0, 1] = DQ[:, 2], DQ[:, 0]
    np.testing.assert_array_equal(regressor(term), expected)


def test_names_expressions_and_values_can_be_given():
    (parameter,) = Viscous(JOINTS, on=("rail",), names=("mu",), expressions=("mu1",), values=(0.6,)).parameters
    assert (parameter.name, parameter.expression, parameter.value) == ("mu", "mu1", 0.6)
