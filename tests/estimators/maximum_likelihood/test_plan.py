"""Noise, steps and knots, found from a log."""

import numpy as np
import pytest

from dynident.estimators.maximum_likelihood import plan_segment, torque_steps, whiteness_probability
from dynident.motion.log import Log


class TestPlan:
    def test_finds_steps_and_no_others(self, rng: np.random.Generator) -> None:
        t = np.arange(2000) * 0.01
        tau = np.stack([np.sin(t), np.where(t >= 7.0, 3.0, -1.0)], axis=1) + 0.1 * rng.standard_normal((2000, 2))
        log = Log(t, np.zeros_like(tau), tau, ("a", "b"))
        assert torque_steps(log, np.full(2, 0.1)) == pytest.approx((7.0,))

    def test_outliers_are_no_steps(self, rng: np.random.Generator) -> None:
        t = np.arange(4000) * 0.0025
        tau = np.stack([6 * np.sin(t), np.where(t >= 7.0, 3.0, -1.0)], axis=1) + 0.1 * rng.standard_normal((4000, 2))
        tau[rng.random(tau.shape) < 0.02] += 5.0
        log = Log(t, np.zeros_like(tau), tau, ("a", "b"))
        assert torque_steps(log, np.full(2, 0.1)) == pytest.approx((7.0,), abs=0.01)

    def test_torque_knots_are_as_far_apart_as_the_torque_allows(self) -> None:
        t = np.arange(400) * 0.01
        smooth, fast = (np.sin(rate * t)[:, None] for rate in (1.0, 15.0))
        gaps = []
        for tau in (smooth, fast):
            log = Log(t, np.zeros_like(tau), tau, ("a",))
            gaps.append(np.diff(plan_segment(log, (), 20.0, np.array([0.02]), from_rest=True).torque_knots[0])[0])
        assert gaps[0] == pytest.approx(0.15)
        assert gaps[1] < 0.1

    def test_whiteness(self, rng: np.random.Generator) -> None:
        white = rng.standard_normal((4000, 2))
        assert whiteness_probability(white, 0) > 1e-3
        assert whiteness_probability(white + 0.3 * np.sin(np.arange(4000) / 50)[:, None], 0) < 1e-6
