"""The spline smoother: what it says of itself, and what it cannot smooth."""

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
