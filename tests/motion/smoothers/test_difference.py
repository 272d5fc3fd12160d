"""Differences: the article's equations, and their masks."""

from __future__ import annotations

import numpy as np

from dynident.motion.log import Log
from dynident.motion.smoothers import Difference


def log(n: int = 4001, h: float = 0.0025, noise: float = 1e-3) -> Log:
    t = np.arange(n) * h
    q = np.column_stack((np.sin(t), np.cos(2 * t))) + noise * np.random.default_rng(0).standard_normal((n, 2))
    return Log(t, q, np.zeros((n, 2)), ("a", "b"), "made")


def test_forward_differences_as_printed() -> None:
    """Eqs. (47)-(48), with the two last samples masked."""
    made, data = Difference()(log()), log().q
    dq = (data[1:] - data[:-1]) / 0.0025
    np.testing.assert_allclose(made.dq[:-1], dq, rtol=1e-9)
    np.testing.assert_allclose(made.ddq[:-2], (dq[1:] - dq[:-1]) / 0.0025, rtol=1e-6, atol=1e-8)
    np.testing.assert_array_equal(np.flatnonzero(~made.mask), [3999, 4000])


def test_central_differences_are_exact_for_a_parabola_on_any_grid() -> None:
    t = np.cumsum(np.random.default_rng(0).uniform(0.5, 2, 50))
    made = Difference("central")(Log(t, (t**2 - 3 * t)[:, None], np.zeros((50, 1)), ("a",)))
    np.testing.assert_allclose(made.dq[made.mask, 0], (2 * t - 3)[made.mask], rtol=1e-10)
    np.testing.assert_allclose(made.ddq[made.mask], 2.0, rtol=1e-8)
