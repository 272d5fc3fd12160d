"""The laws of single joints in numbers; what every term promises is in ``tests/laws``."""

import numpy as np
import pytest

from dynident.models import Joint
from dynident.models.friction import Coulomb, Offset, Power, Ripple, Stribeck, Viscous
from dynident.runtime import ModelError

JOINTS = (Joint("base"), Joint("rail", "prismatic"), Joint("wrist"))
PAIR = Joint("a"), Joint("b")
DQ = np.array([[1.0, -2.0, 0.5], [0.0, 1e-4, -3.0]])
SHARP = {
    "coulomb": Coulomb(JOINTS, on=("wrist", "base"), width={"wrist": 0.3, "base": 0.0}),
    "stribeck": Stribeck(JOINTS, on=("wrist", "base"), velocity=1.0, width={"wrist": 0.3, "base": 0.0}),
    "power": Power(JOINTS, on=("wrist", "base"), exponent=0.5, width={"wrist": 0.3, "base": 0.0}),
}
BY_JOINT = {"width": {"base": 0.5, "rail": 0, "wrist": 0}, "dead_band": {"base": 0, "rail": 3, "wrist": 0}}


def regressor(term):
    return term.regressor(np.zeros_like(DQ), DQ, np.zeros_like(DQ))


@pytest.mark.parametrize(
    ("term", "diagonal"),
    [
        (Viscous(JOINTS), DQ),
        (Coulomb(JOINTS), np.sign(DQ)),
        (Offset(JOINTS), np.ones_like(DQ)),
        (Coulomb(JOINTS, width=0.5), np.tanh(DQ / 0.5)),
        (Coulomb(JOINTS, dead_band=1.0), [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]),  # the edge of the band belongs to it
        (Coulomb(JOINTS, **BY_JOINT), [[np.tanh(2.0), 0.0, 1.0], [0.0, 0.0, -1.0]]),
        (Power(JOINTS, exponent={"base": 0.5, "rail": 3, "wrist": 2}), [[1.0, -8.0, 0.25], [0.0, 1e-12, -9.0]]),
    ],
)
def test_each_joint_has_its_own_column(term, diagonal):
    np.testing.assert_allclose(regressor(term), np.array(diagonal)[:, :, None] * np.eye(3), rtol=1e-14)


def test_cycles_that_are_listed_twice_are_named():
    with pytest.raises(ModelError, match="cycles of joint 'wrist' list 40 twice"):
        Ripple(JOINTS[::2], cycles={"base": (40, 80), "wrist": (20, 40, 40)})


def test_a_narrow_smooth_sign_does_not_overflow():
    slope = Coulomb(JOINTS, width=1e-300).partials(DQ, DQ, DQ, np.ones(3)).dq
    assert slope[0].max() == 0.0


def test_dry_friction_is_continuous_with_a_width_a_dead_band_or_a_power_from_one_on():
    assert [Coulomb(JOINTS, **how).discontinuous for how in ({}, {"width": 0.1}, {"dead_band": 0.1})] == [1, 0, 0]
    assert not Power(JOINTS, exponent=1.0).discontinuous
    assert Power(JOINTS, exponent={"base": 2, "rail": 0.9, "wrist": 1}).discontinuous
    term = Coulomb(JOINTS, **BY_JOINT)
    assert [term.rule(name) for name in ("base", "rail", "wrist")] == [(0.5, 0.0), (0.0, 3.0), (0.0, 0.0)]


@pytest.mark.parametrize("term", SHARP.values(), ids=SHARP)
def test_a_sign_is_smoothed_at_the_joints_where_it_is_sharp(term):
    (smooth,) = term.with_smooth_sign(np.array([0.01, 0.02, 0.04]))
    assert term.discontinuous
    assert not smooth.discontinuous
    assert smooth.width == (("wrist", 0.3), ("base", 0.01))
    assert type(smooth) is type(term)


@pytest.mark.parametrize("term", SHARP.values(), ids=SHARP)
def test_the_slope_is_finite_at_rest_and_close_to_it(term):
    dq = np.array([[0.0] * 3, [1e-300] * 3, [-1e-12] * 3])
    slope = term.partials(dq, dq, dq, np.ones(2)).dq
    assert np.isfinite(slope).all()
    assert slope[0, 0, 0] == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"on": ("wirst",)}, r"Coulomb: no joint 'wirst'; did you mean 'wrist'\? Choose from 'base', 'rail', 'wrist'"),
        ({"on": ("base", "base")}, "joint 'base' is listed twice"),
        ({"names": ("a", "b")}, r"2 names for 3 joints \(base, rail, wrist\)"),
        ({"on": ("base",), "values": (1.0, 2.0)}, r"2 values for 1 joints \(base\)"),
        ({"width": 0.1, "dead_band": 0.1}, "width 0.1 and dead_band 0.1 exclude each other"),
        ({"width": -0.1}, "width is -0.1; give a velocity of 0 or more"),
        ({"dead_band": float("nan")}, "dead_band is nan"),
        ({"width": float("inf")}, "width is inf"),
        ({"velocity": 0.0}, "velocity is 0.0; give a velocity above 0"),
    ],
)
def test_wrong_fields(arguments, message):
    with pytest.raises(ModelError, match=message):
        (Stribeck if "velocity" in arguments else Coulomb)(JOINTS, **arguments)


def test_a_term_without_a_law_says_what_it_lacks():
    class Mute(Viscous):
        law = ""

    with pytest.raises(ModelError, match="Mute: give its torque as text by `law`, or by a method `shapes`"):
        regressor(Mute(JOINTS))


def test_a_subclass_with_another_law_has_another_one():
    class Cubic(Viscous):
        law = "dq**3"

    class Twice(Viscous):
        def shapes(self, q, dq, ddq):
            return 2 * dq

    assert Cubic(PAIR).equations[0].torque == "F_v * dq**3"
    assert Twice(PAIR).equations == ()
