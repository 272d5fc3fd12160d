"""Friction with smooth signs."""

import numpy as np

from dynident.estimators.maximum_likelihood import has_sign, with_smooth_signs
from dynident.models import CoupledMotor, Joint, Model
from dynident.models.friction import Coulomb, Power, Stribeck, Viscous


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

    def test_every_sign_is_smoothed_where_it_is_sharp(self) -> None:
        """At the joint whose sign has a width, that width stays."""
        joints, by_joint = (Joint("a"), Joint("b")), {"a": 0.0, "b": 0.5}
        terms = (
            Coulomb(joints, width=by_joint),
            Stribeck(joints, velocity=1.0, width=by_joint),
            Power(joints, exponent=0.5, width=by_joint),
        )
        sharp = Model(terms)
        soft = with_smooth_signs(sharp, np.array([0.01, 0.02]))
        assert (has_sign(sharp), has_sign(soft), soft.names) == (True, False, sharp.names)
        states = np.zeros((1, 2)), np.array([[0.01, 0.02]]), np.zeros((1, 2))
        columns = soft.regressor(*states)[0]
        ratio = columns[0, ::2] / [1.0, np.exp(-1e-4), 0.1]
        np.testing.assert_allclose(ratio, np.tanh(1.0))
        np.testing.assert_array_equal(columns[1], sharp.regressor(*states)[0, 1])
        assert np.isfinite(soft.partials(*(np.zeros((1, 2)),) * 3, np.ones(6)).dq).all()
