"""Motors that turn with several joints."""

import numpy as np
import pytest

from dynident.models import CoupledMotor, Joint, Model
from dynident.runtime import ModelError

JOINTS = (Joint("base"), Joint("rail", "prismatic"), Joint("wrist"))
ARM = (Joint("shoulder"), Joint("elbow"))
Q, DQ, DDQ = np.random.default_rng(0).normal(size=(3, 4, 3))


def test_wrist_that_rides_on_the_axis_before():
    """tau_5 = tau_6 = Ia (ddq5 + ddq6) + Fv (dq5 + dq6) + Fc sign(dq5 + dq6)."""
    term = CoupledMotor(JOINTS, {"base": 1.0, "wrist": 1.0}, "m6")
    sums = DDQ[:, 0] + DDQ[:, 2], DQ[:, 0] + DQ[:, 2], np.sign(DQ[:, 0] + DQ[:, 2])
    Y = term.regressor(Q, DQ, DDQ)
    for k, column in enumerate(sums):
        np.testing.assert_allclose(Y[:, :, k], column[:, None] * [1.0, 0.0, 1.0], rtol=1e-15)
    assert [(p.name, p.unit, p.role) for p in term.parameters] == [
        ("Ia_m6", "kg m^2", "rotor"),
        ("Fv_m6", "N m s/rad", "viscous"),
        ("Fc_m6", "N m", "coulomb"),
    ]
    assert term.parameters[1].expression.endswith("of the motor at 1 base + 1 wrist")


def test_elbow_motor_on_the_first_link():
    """Its rotor adds Ir [[1, -6], [-6, 36]] to the mass matrix."""
    term = CoupledMotor(ARM, {"shoulder": 1, "elbow": -6}, "elbow", viscous=False, coulomb=False, values=(0.01,))
    mass = Model((term,)).mass_matrix(np.zeros((1, 2)), [0.01])[0]
    np.testing.assert_allclose(mass, [[0.01, -0.06], [-0.06, 0.36]], rtol=1e-14)
    assert term.parameters[0].value == 0.01


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"coefficients": {"elbo": 1}}, "no joint 'elbo'; did you mean 'elbow'"),
        ({"coefficients": (("elbow", 1), ("elbow", 2))}, "'elbow' is listed twice"),
        ({"coefficients": {"elbow": 0}}, "coefficient of 'elbow' is 0.0"),
        ({"coefficients": {"elbow": np.inf}}, "coefficient of 'elbow' is inf"),
        ({"coefficients": {}}, "no joint is coupled"),
        ({"inertia": False, "viscous": False, "coulomb": False}, "no part is left"),
        ({"values": (1.0,)}, r"1 values for 3 parameters \(Ia_m, Fv_m, Fc_m\)"),
        ({"width": -1.0}, "width is -1.0"),
    ],
)
def test_wrong_fields(arguments, message):
    with pytest.raises(ModelError, match=message):
        CoupledMotor(**{"joints": ARM, "coefficients": {"elbow": 2.0}, "name": "m", **arguments})
