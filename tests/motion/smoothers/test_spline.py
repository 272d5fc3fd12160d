"""The spline smoother: what it says of itself, and what it cannot smooth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.motion.log import Log
from dynident.motion.smoothers import KalmanSmoother, Smoother, Spline, TimeShifted
from dynident.motion.splines import Fixed
from dynident.runtime import InputError
from tests.motion.smoothers.test_difference import log


def test_a_joint_that_double_precision_cannot_smooth_is_named() -> None:
    t = np.arange(60_000) * 1e-6
    made = Log(t, np.sin(40 * t)[:, None] * [1.0, 2.0], np.zeros((len(t), 2)), ("wrist", "hand"), "run")
    with pytest.raises(InputError, match="run: joint 'wrist' cannot be smoothed with these settings"):
        Spline(Fixed(lam=20000.0**4 * 1e-18))(made)


@pytest.mark.parametrize("smoother", [Spline(factor=1.4), KalmanSmoother(2), KalmanSmoother(3)], ids=repr)
def test_what_is_shifted_is_as_used_smoothed_as_much_and_linear(smoother: Smoother) -> None:
    """Without a shift that is a promise of every smoother."""
    test_log, delayed = log(1500), TimeShifted(smoother, 1e-3)
    made, again = delayed(test_log), delayed.as_used(delayed(test_log))
    np.testing.assert_allclose(again(test_log).ddq, made.ddq, rtol=1e-9, atol=1e-8)
    np.testing.assert_array_equal(again(test_log).mask, made.mask)
    np.testing.assert_allclose(again(replace(test_log, q=2 * test_log.q)).ddq, 2 * made.ddq, rtol=1e-9, atol=1e-8)


def test_the_factor_of_each_joint() -> None:
    plain, made = Spline(sigma=1e-3)(log()), Spline(sigma=1e-3, factor={"b": 2.0})(log())
    np.testing.assert_array_equal(made.q[:, 0], plain.q[:, 0])
    np.testing.assert_array_equal(made.q[:, 1], Spline(sigma=1e-3, factor=2.0)(log()).q[:, 1])
    assert made.smoothing["sigma"] == (1e-3, 2e-3)
    estimated = Spline(factor={"a": 3.0, "b": 1.0})(log()).smoothing["sigma"]
    assert estimated == pytest.approx((3e-3, 1e-3), rel=0.1)
    mixed = Spline(sigma={"a": 2e-3}, factor={"a": 3.0})(log()).smoothing["sigma"]
    assert mixed == pytest.approx((6e-3, 1e-3), rel=0.1)


def test_the_factor_of_each_joint_as_settings() -> None:
    given = Spline.Settings(rule="torque", factor={"a": 2.0, "b": 1.0}).build()
    assert isinstance(given, tuple)
    assert [x.factor for x in given[:2]] == [{"a": 2.0, "b": 1.0}, {"a": 2.8, "b": 1.4}]
    assert Spline.Settings.of(Spline(factor={"a": 2.0})).build() == Spline(factor={"a": 2.0})
