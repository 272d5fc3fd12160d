"""The noise that a smoothed motion has left, against the truth of simulated logs."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.estimators.total_least_squares import motion_noise
from dynident.models.lagrangian import pendulum
from dynident.models.simulation import record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Butterworth, Difference, Spline

T = np.arange(2001) * 0.01
ARM = pendulum()


@cache
def exact() -> Motion:
    return simulate(ARM, ARM.values, lambda s: [0.4 * np.sin(5 * s)], T)


def recorded(sigma: float, seed: int = 0) -> Log:
    return record(exact(), sigma_q=sigma, sigma_tau=0.01, rng=np.random.default_rng(seed)).log


@pytest.mark.parametrize("sigma", [5e-4, 2e-3])
@pytest.mark.parametrize("smoother", [Spline, Butterworth, Difference], ids=lambda one: one.__name__)
def test_errors_that_are_drawn_are_as_large_as_the_true_ones(smoother, sigma):
    log = recorded(sigma)
    part = {Spline: Spline(sigma=0.9 * sigma), Butterworth: Butterworth(cutoffs=(8.0, 8.0, 8.0)),
            Difference: Difference("central")}[smoother]  # fmt: skip
    motion = part(log)
    noise = motion_noise(log, motion)
    np.testing.assert_allclose(np.sqrt(noise.density / 0.02), sigma, rtol=0.05)
    again = noise.draw(motion, np.random.default_rng(1))
    clean = exact() if smoother is Spline else part(replace(log, q=exact().q))
    for name in ("dq", "ddq"):
        made, true = (getattr(again, name) - getattr(motion, name)), (getattr(motion, name) - getattr(clean, name))
        near = 1.4 if smoother is Spline else 2.5  # another smoother has another shape than a spline's
        ratio = made[motion.mask].std() / true[motion.mask].std()
        assert 1 / near < ratio < near, (name, ratio)


def test_shifted_positions():
    log = recorded(2e-3)
    motion = Spline(sigma=1.8e-3)(log)
    late = motion.shift(0.02)
    near, far = motion_noise(log, motion), motion_noise(log, late, 0.02)
    np.testing.assert_allclose(far.cutoff, near.cutoff, rtol=0.15)


def test_few_samples_show_nothing():
    log = recorded(2e-3).window(0, 0.1)
    motion = Difference("central")(log)
    assert (motion_noise(log, motion).density == 0).all()
