"""Powers of the speed."""

import numpy as np

from dynident.models import Joint
from dynident.models.friction import Power

JOINTS = (Joint("base"), Joint("rail", "prismatic"))


def test_each_joint_has_its_exponent():
    dq = np.array([[-4.0, -2.0], [0.0, 0.0]])
    term = Power(JOINTS, exponent={"base": 0.5, "rail": 3})
    np.testing.assert_allclose(term.torque(dq, dq, dq, np.array([1.0, 10.0])), [[-2.0, -80.0], [0.0, 0.0]])


def test_units_follow_the_exponent():
    found = [one.unit for one in Power(JOINTS, exponent={"base": 0.5, "rail": 2}).parameters]
    assert found == ["N m (s/rad)^0.5", "N (s/m)^2"]
