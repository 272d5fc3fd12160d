"""Joints at rest in a whole log."""

from __future__ import annotations

import numpy as np

from dynident.motion.smoothers.smoother import at_rest, with_rest


def test_within_the_noise_or_two_counts_a_joint_rests() -> None:
    rng = np.random.default_rng(0)
    moving, noisy, flickering = (
        np.linspace(0.0, 1.0, 500),
        1e-3 * rng.standard_normal(500),
        rng.integers(0, 2, 500) * 0.01,
    )
    q = np.column_stack((moving, noisy, flickering))
    smoothed = np.column_stack((moving, np.zeros(500), 0.005 + 0.004 * np.sin(moving)))
    still = at_rest(q, smoothed, np.full(3, 1e-3))
    assert still.tolist() == [False, True, True]
    rests = with_rest(still, q, (smoothed, smoothed, smoothed))
    assert rests[0][0, 2] == q.mean(axis=0)[2]
    assert not rests[2][:, 1:].any()
    np.testing.assert_array_equal(rests[1][:, 0], moving)
