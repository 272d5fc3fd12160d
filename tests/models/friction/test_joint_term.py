"""Constants of a shape by joint, and terms with several parameters per joint."""

import numpy as np
import pytest

from dynident.models import Joint
from dynident.models.friction import Coulomb, Power, Ripple, Spring, Stribeck
from dynident.runtime import ModelError

JOINTS = (Joint("base"), Joint("rail", "prismatic"), Joint("wrist"))
STATES = np.random.default_rng(0).normal(size=(3, 20, 3))


def test_a_constant_by_joint_is_that_of_each_joint():
    whole = Stribeck(
        JOINTS, on=("wrist", "base"), velocity={"base": 0.5, "wrist": 2.0}, width={"wrist": 0.0, "base": 1}
    )
    parts = [Stribeck(JOINTS, on=("wrist",), velocity=2.0), Stribeck(JOINTS, on=("base",), velocity=0.5, width=1)]
    expected = np.concatenate([part.regressor(*STATES) for part in parts], axis=2)
    np.testing.assert_array_equal(whole.regressor(*STATES), expected)
    assert whole.parameters == tuple(one for part in parts for one in part.parameters)
    assert [whole.for_joint(name) for name in ("wrist", "base")] == parts


def test_the_same_constants_in_another_order_are_the_same_term():
    one, two = (Coulomb(JOINTS[:2], width=dict(pairs)) for pairs in ([("base", 1.0), ("rail", 2.0)],) * 2)
    assert one == two == Coulomb(JOINTS[:2], width={"rail": 2.0, "base": 1.0})
    assert hash(one) == hash(two)


def test_parameters_follow_the_joints_and_their_numbers():
    ripple = Ripple(JOINTS, on=("wrist", "base"), cycles={"base": 7, "wrist": (3, 5)})
    assert [one.name for one in ripple.parameters] == [
        "ripple_wrist_sin3", "ripple_wrist_cos3", "ripple_wrist_sin5", "ripple_wrist_cos5",
        "ripple_base_sin7", "ripple_base_cos7",
    ]  # fmt: skip
    np.testing.assert_array_equal(ripple.support.sum(axis=1), [2, 0, 4])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Coulomb(JOINTS, width={"base": 0.1}),
            "width lacks joint 'rail'; give it for base, rail, wrist",
        ),
        (
            lambda: Coulomb(JOINTS, on=("base",), width={"bsae": 0.1}),
            "width is given for 'bsae'; did you mean 'base'",
        ),
        (lambda: Coulomb(JOINTS, on=("base",), width={"base": 0.1, "rail": 0.2}), "width is given for 'rail'"),
        (
            lambda: Stribeck(JOINTS, velocity={"base": 1, "rail": 0, "wrist": 1}),
            "velocity of joint 'rail' is 0; give",
        ),
        (lambda: Stribeck(JOINTS, velocity=float("nan")), "Stribeck: velocity is nan; give a velocity above 0"),
        (lambda: Stribeck(JOINTS, velocity="0.1"), "Stribeck: velocity is 0.1; give a velocity above 0"),
        (lambda: Spring(JOINTS, on=()), "Spring: 'on' names no joint; name one of base, rail, wrist"),
        (lambda: Power(JOINTS, exponent=3.5), "Power: exponent is 3.5; give an exponent above 0, at most 3"),
        (lambda: Ripple(JOINTS, cycles=()), "Ripple: cycles is empty; give numbers"),
        (lambda: Ripple(JOINTS, cycles={"base": 1, "rail": (), "wrist": 1}), "cycles of joint 'rail' is empty"),
        (lambda: Ripple(JOINTS, cycles=(5, 7, 5.0)), "cycles of joint 'base' list 5 twice"),
        (lambda: Spring(JOINTS, order=1.5), "Spring: order is 1.5; give 1, 2 or 3"),
        (
            lambda: Ripple(JOINTS, on=("base",), cycles=5, values=(1.0,)),
            "1 values for 2 parameters of joints",
        ),
    ],
)
def test_wrong_constants(make, message):
    with pytest.raises(ModelError, match=message):
        make()
