"""Springs as series."""

import numpy as np

from dynident.models import Joint
from dynident.models.friction import Spring

JOINTS = (Joint("base"), Joint("rail", "prismatic"))


def test_a_turning_joint_has_a_fourier_series_and_a_sliding_one_powers():
    q = np.array([[0.3, -2.0]])
    Y = Spring(JOINTS, order={"base": 2, "rail": 3}).regressor(q, q, q)[0]
    expected = [np.sin(0.3), np.cos(0.3), np.sin(0.6), np.cos(0.6)]
    np.testing.assert_allclose(Y, [[*expected, 0, 0, 0], [0, 0, 0, 0, -2.0, 4.0, -8.0]], rtol=1e-14)


def test_names_and_units():
    found = Spring(JOINTS, order={"base": 1, "rail": 2}).parameters
    assert [(one.name, one.unit) for one in found] == [
        ("spring_base_sin1", "N m"), ("spring_base_cos1", "N m"),
        ("spring_rail_q1", "N/m"), ("spring_rail_q2", "N/m^2"),
    ]  # fmt: skip
    assert [one.expression for one in found][::2] == ["spring: torque per sin(q)", "spring: torque per q"]
