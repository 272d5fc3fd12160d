"""Equations of terms; that they are the terms' torques is a promise of every term (``dynident.testing``)."""

import numpy as np

from dynident.models import FUNCTIONS, Joint
from dynident.models.friction import Offset, Viscous

JOINTS = Joint("a"), Joint("b")


def test_the_sign_has_a_dead_band():
    assert FUNCTIONS["sign"](np.array([-2.0, -0.5, 0.0, 0.5, 2.0]), 1.0).tolist() == [-1, 0, 0, 0, 1]
    assert FUNCTIONS["sign"](np.array([-2.0, 0.0])).tolist() == [-1, 0]


def test_there_is_one_for_each_joint():
    first, second = Viscous(JOINTS, names=("x", "y")).equations
    assert (first.on, first.parameters) == ((("a", 1.0),), ("x",))
    assert (second.on, second.parameters) == ((("b", 1.0),), ("y",))
    assert [one.on[0][0] for one in Offset(JOINTS, on=("b",)).equations] == ["b"]


def test_a_subclass_with_another_law_has_another_one():
    class Cubic(Viscous):
        law = "dq**3"

    class Twice(Viscous):
        def shapes(self, q, dq, ddq):
            return 2 * dq

    assert Cubic(JOINTS).equations[0].torque == "F_v * dq**3"
    assert Twice(JOINTS).equations == ()
