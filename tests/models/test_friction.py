"""Friction and offset of single joints."""

import numpy as np
import pytest

from dynident.errors import ModelError
from dynident.models import Coulomb, Joint, Offset, Viscous

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


def test_smooth_sign():
    term = Coulomb(JOINTS, width=0.5)
    np.testing.assert_allclose(regressor(term), np.tanh(DQ / 0.5)[:, :, None] * np.eye(3), rtol=1e-15)
    assert term.parameters[0].expression == "Coulomb friction: torque per tanh(dq/0.5)"


def test_dead_band():
    """The edge of the band belongs to it."""
    term = Coulomb(JOINTS, dead_band=1.0)
    diagonal = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    np.testing.assert_array_equal(regressor(term), diagonal[:, :, None] * np.eye(3))
    assert term.parameters[0].expression.endswith("0 within abs(dq) <= 1")


def test_a_narrow_smooth_sign_does_not_overflow():
    slope = Coulomb(JOINTS, width=1e-300).partials(DQ, DQ, DQ, np.ones(3)).dq
    assert slope[0].max() == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"on": ("wirst",)}, r"Coulomb: no joint 'wirst'; did you mean 'wrist'\? Known: 'base', 'rail', 'wrist'"),
        ({"on": ("base", "base")}, "joint 'base' is listed twice"),
        ({"names": ("a", "b")}, r"2 names for 3 joints \(base, rail, wrist\)"),
        ({"on": ("base",), "values": (1.0, 2.0)}, r"2 values for 1 joints \(base\)"),
        ({"width": 0.1, "dead_band": 0.1}, "width 0.1 and dead_band 0.1 exclude each other"),
        ({"width": -0.1}, "width is -0.1; give a velocity of 0 or more"),
        ({"dead_band": float("nan")}, "dead_band is nan"),
        ({"width": float("inf")}, "width is inf"),
    ],
)
def test_wrong_fields(arguments, message):
    with pytest.raises(ModelError, match=message):
        Coulomb(JOINTS, **arguments)


def test_dry_friction_is_continuous_with_a_width_or_a_dead_band() -> None:
    assert Coulomb(JOINTS).discontinuous
    assert not Coulomb(JOINTS, width=0.1).discontinuous
    assert not Coulomb(JOINTS, dead_band=0.1).discontinuous
