"""Friction of a coupled motor is that of a single joint, at the motor's coordinate."""

from typing import Any

import numpy as np
import pytest

from dynident.models import CoupledFriction, Joint
from dynident.models.friction import Power
from dynident.runtime import ModelError

WRIST = tuple(map(Joint, ("a", "b", "c")))
SHARES = {"b": 1.0, "c": -2.0}


def test_it_does_the_work_of_the_motor() -> None:
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 10, 3))
    dphi = dq @ [0.0, 1.0, -2.0]
    f = Power((Joint("m"),), exponent=0.3).regressor(*(dphi[:, None],) * 3)[:, 0]
    Y = CoupledFriction(WRIST, SHARES, "m", "power", {"exponent": 0.3}).regressor(q, dq, ddq)
    assert np.allclose(Y[:, :, 0], f * [0.0, 1.0, -2.0])
    assert np.allclose(np.sum(Y[:, :, 0] * dq, axis=1), f[:, 0] * dphi)


def test_a_sharp_sign_becomes_smooth() -> None:
    sharp = CoupledFriction(WRIST, SHARES, "m", "coulomb")
    (smooth,) = sharp.with_smooth_sign(np.array([0.1, 0.3, 0.2]))
    assert sharp.discontinuous
    assert not smooth.discontinuous
    assert dict(smooth.settings)["width"] == pytest.approx(0.5)
    assert not CoupledFriction(WRIST, SHARES, "m", "asymmetric_viscous").discontinuous


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"law": "powers"}, "no law 'powers'; did you mean 'power'"),
        (
            {"settings": {"width": 0.1}, "law": "asymmetric_viscous"},
            "asymmetric_viscous has no constant 'width'; leave it out",
        ),
        ({"settings": {"exponents": 0.1}}, "power has no constant 'exponents'; did you mean 'exponent'"),
        ({"settings": {"exponent": 7.0}}, "exponent is 7.0"),
        ({"coefficients": {"d": 1.0}}, "no joint 'd'"),
    ],
)
def test_wrong_settings_are_named(arguments: dict[str, Any], message: str) -> None:
    given = {"joints": WRIST, "coefficients": SHARES, "name": "m", "law": "power", "settings": {"exponent": 0.5}}
    with pytest.raises(ModelError, match=message):
        CoupledFriction(**given | arguments)


def test_a_constant_that_is_missing_is_named() -> None:
    with pytest.raises(ModelError, match="power needs its constant 'exponent'"):
        CoupledFriction(WRIST, SHARES, "m", "power")
