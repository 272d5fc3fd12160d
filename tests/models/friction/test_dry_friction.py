"""Friction with the sign of the velocity."""

import numpy as np
import pytest

from dynident.models import Joint
from dynident.models.friction import Coulomb, Power, Stribeck

JOINTS = (Joint("base"), Joint("rail", "prismatic"), Joint("wrist"))
TERMS = {
    "coulomb": Coulomb(JOINTS, on=("wrist", "base"), width={"wrist": 0.3, "base": 0.0}),
    "stribeck": Stribeck(JOINTS, on=("wrist", "base"), velocity=1.0, width={"wrist": 0.3, "base": 0.0}),
    "power": Power(JOINTS, on=("wrist", "base"), exponent=0.5, width={"wrist": 0.3, "base": 0.0}),
}


@pytest.mark.parametrize("term", TERMS.values(), ids=TERMS)
def test_a_sign_is_smoothed_at_the_joints_where_it_is_sharp(term):
    (smooth,) = term.with_smooth_sign(np.array([0.01, 0.02, 0.04]))
    assert term.discontinuous
    assert not smooth.discontinuous
    assert smooth.width == (("wrist", 0.3), ("base", 0.01))
    assert type(smooth) is type(term)


@pytest.mark.parametrize("term", TERMS.values(), ids=TERMS)
def test_the_slope_is_finite_at_rest_and_close_to_it(term):
    dq = np.array([[0.0] * 3, [1e-300] * 3, [-1e-12] * 3])
    slope = term.partials(dq, dq, dq, np.ones(2)).dq
    assert np.isfinite(slope).all()
    assert slope[0, 0, 0] == 0.0


def test_a_power_from_one_on_needs_no_width():
    assert not Power(JOINTS, exponent=1.0).discontinuous
    assert Power(JOINTS, exponent={"base": 2, "rail": 0.9, "wrist": 1}).discontinuous
