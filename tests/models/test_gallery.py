"""The ready-made models have the parameters that they promise."""

import numpy as np

from dynident.models.lagrangian import two_link_arm

PUBLISHED = (0.0340, 0.0030, 0.0045, 0.1329, 0.0170, 0.6189, 0.6189)  # article, tables 2, 4 and 6, "True value"


def test_two_link_arm_is_the_article_s():
    """Eqs. (37) and (40)."""
    arm = two_link_arm.__wrapped__()  # anew
    assert arm.names == tuple(f"theta{k}" for k in range(1, 8))
    assert [joint.name for joint in arm.joints] == ["joint1", "joint2"]
    assert [p.expression for p in arm.parameters] == [
        "I1 + l1**2*m2 + lc1**2*m1",
        "I2 + lc2**2*m2",
        "l1*lc2*m2",
        "l1*m2 + lc1*m1",
        "lc2*m2",
        "mu1",
        "mu2",
    ]
    assert [p.unit for p in arm.parameters] == ["kg m^2"] * 3 + ["kg m"] * 2 + ["N m s/rad"] * 2
    l1, lc1, lc2, m1, m2, inertia = 0.2675, 0.0398, 0.0392, 0.4347, 0.4322, 0.0024
    expected = [m1 * lc1**2 + inertia + m2 * l1**2, m2 * lc2**2 + inertia, m2 * l1 * lc2, m1 * lc1 + m2 * l1, m2 * lc2]
    np.testing.assert_allclose(arm.values, [*expected, 0.6189, 0.6189], rtol=1e-14)


def test_true_values_of_the_article():
    """Eq. (37) gives 0.00306 and 0.01694 for the printed 0.0030 and 0.0170: its numbers are themselves rounded.

    So the printed column must lie in the range that eq. (40) takes over the rounding of its inputs.
    """
    inputs = {"l1": 0.2675, "lc1": 0.0398, "lc2": 0.0392, "m1": 0.4347, "m2": 0.4322, "I1": 0.0024, "I2": 0.0024}
    low, high = ({name: value + sign * 5e-5 for name, value in inputs.items()} for sign in (-1, 1))
    for parameter, printed in zip(two_link_arm().parameters[:5], PUBLISHED, strict=False):
        least, most = (eval(parameter.expression, {}, ends) for ends in (low, high))  # all terms increase
        assert least < parameter.value < most
        assert least - 5e-5 <= printed <= most + 5e-5
    exact = np.round(two_link_arm().values, 4)
    assert [k + 1 for k in range(7) if exact[k] != PUBLISHED[k]] == [2, 5]
    np.testing.assert_allclose(two_link_arm().values, PUBLISHED, atol=1e-4)
