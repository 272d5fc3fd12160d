"""Friction with smooth signs."""

import numpy as np

from dynident.estimators.maximum_likelihood import (
    has_sign,
    with_smooth_signs,
)
from dynident.models import Coulomb, CoupledMotor, Joint, Model, Viscous


class TestFriction:
    def test_soft_signs_keep_the_parameters(self) -> None:
        joints = (Joint("a"), Joint("b"))
        terms = (Viscous(joints), Coulomb(joints, names=("x", "y")), CoupledMotor(joints, {"a": 1.0, "b": -2.0}, "m"))
        sharp = Model(terms)
        soft = with_smooth_signs(sharp, np.array([0.01, 0.02]))
        assert has_sign(sharp)
        assert not has_sign(soft)
        assert soft.names == sharp.names
        fast, slow = np.array([[1.0, -1.0]]), np.array([[0.01, -0.02]])
        zero = np.zeros((1, 2))
        np.testing.assert_allclose(soft.regressor(zero, fast, zero), sharp.regressor(zero, fast, zero))
        part = soft.regressor(zero, slow, zero)[0, :, [2, 3]]
        np.testing.assert_allclose(np.diag(part), np.tanh(1.0) * np.array([1.0, -1.0]))
