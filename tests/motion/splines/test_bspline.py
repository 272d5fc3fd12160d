"""B-splines against SciPy's, for every degree in use, also at repeated knots."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from dynident.motion.splines.quintic import local_basis


@pytest.mark.parametrize(("degree", "repeated"), [(2, 1), (3, 1), (4, 1), (4, 2)])
def test_agrees_with_scipy(degree: int, repeated: int) -> None:
    rng = np.random.default_rng(0)
    inside = np.repeat(np.cumsum(rng.uniform(0.1, 1.0, 6)), np.array([1, 1, repeated, 1, 1, 1]))
    knots = np.concatenate([np.zeros(degree + 1), inside, np.full(degree + 1, inside[-1] + 0.5)])
    t = np.concatenate([np.sort(rng.uniform(0, knots[-1], 60)), [0.0]])
    m = np.searchsorted(knots, t, side="right") - 1
    found, count = local_basis(knots, degree, m, t), len(knots) - degree - 1
    spline = BSpline(knots, np.eye(count), degree)
    for order in range(3):
        whole = np.zeros((len(t), count))
        whole[np.arange(len(t))[:, None], m[:, None] - degree + np.arange(degree + 1)] = found[order]
        expected = spline.derivative(order)(t) if order else spline(t)
        np.testing.assert_allclose(whole, expected, rtol=1e-10, atol=1e-9)
