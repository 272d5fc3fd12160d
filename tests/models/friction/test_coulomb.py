"""Coulomb friction."""

import numpy as np
import pytest

from dynident.models import Joint
from dynident.models.friction import Coulomb
from dynident.runtime import ModelError

JOINTS = (Joint("base"), Joint("rail", "prismatic"), Joint("wrist"))
DQ = np.array([[1.0, -2.0, 0.5], [0.0, 1e-4, -3.0]])


def regressor(term):
    return term.regressor(np.zeros_like(DQ), DQ, np.zeros_like(DQ))


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


def test_width_and_dead_band_by_joint() -> None:
    term = Coulomb(JOINTS, width={"base": 0.5, "rail": 0, "wrist": 0}, dead_band={"base": 0, "rail": 3, "wrist": 0})
    expected = [[np.tanh(2.0), 0.0, 1.0], [0.0, 0.0, -1.0]]
    np.testing.assert_array_equal(regressor(term), np.array(expected)[:, :, None] * np.eye(3))
    assert [one.expression.partition("per ")[2] for one in term.parameters] == [
        "tanh(dq/0.5)", "sign(dq), 0 within abs(dq) <= 3", "sign(dq)",
    ]  # fmt: skip
    assert [term.rule(name) for name in ("base", "rail", "wrist")] == [(0.5, 0.0), (0.0, 3.0), (0.0, 0.0)]
