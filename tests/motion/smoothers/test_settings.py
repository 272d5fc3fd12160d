"""Settings outside their limits are refused by name, and so are those of joints that a log has not."""

import numpy as np
import pytest

from dynident.motion.log import Log
from dynident.motion.smoothers import (
    Butterworth,
    Difference,
    FourierSeries,
    KalmanSmoother,
    SavitzkyGolay,
    Spline,
    TimeShifted,
)
from dynident.runtime import ConfigError

T = np.arange(400) * 0.01
LOG = Log(T, np.column_stack((np.sin(T), np.cos(T))), np.zeros((400, 2)), ("a", "b"))


@pytest.mark.parametrize(
    ("kind", "settings", "words"),
    [
        (Difference, {"scheme": "backward"}, "scheme = 'backward'.*hoose from 'forward', 'central'"),
        (Butterworth, {"orders": (3, 3, 0)}, "entry 3 of orders = 0; give a whole number at least 1 and at most 12"),
        (Butterworth, {"orders": (3, 3)}, "orders = .*; give 3 entries"),
        (Butterworth, {"cutoffs": (10, -3, 2)}, "entry 2 of cutoffs = -3; give a number above 0"),
        (Butterworth, {"settle": (-1, 0)}, "entry 1 of settle = -1"),
        (FourierSeries, {"period": 0.0}, "period = 0.0; give a number above 0, or null"),
        (FourierSeries, {"harmonics": -1}, "harmonics = -1; give a whole number at least 0 and at most 1024"),
        (FourierSeries, {"harmonics": {"a": 5000}}, "harmonics of 'a' = 5000"),
        (FourierSeries, {"settle": (-1.0, 0.0)}, "entry 1 of settle = -1.0"),
        (KalmanSmoother, {"ends": -1.0}, "ends = -1.0"),
        (KalmanSmoother, {"sigma": 0.0}, "sigma = 0.0; give a number above 0, or null"),
        (KalmanSmoother, {"sigma": {"a": np.nan}}, "sigma of 'a' = nan"),
        (KalmanSmoother, {"sigma": 1e-3, "intensity": -1.0}, "intensity = -1.0; give a number at least 0"),
        (SavitzkyGolay, {"window": -1.0}, "window is -1.0"),
        (SavitzkyGolay, {"window": {"a": 0.0}}, "window is 0.0"),
        (SavitzkyGolay, {"order": 1}, "order = 1; give a whole number at least 2 and at most 10"),
        (SavitzkyGolay, {"factor": 0.0}, "factor = 0.0"),
        (Spline, {"ends": -1}, "ends = -1"),
        (Spline, {"factor": {"a": 0.0}}, "factor of 'a' = 0.0"),
        (TimeShifted, {"smoother": Spline(), "time_offset": 61.0}, "time_offset = 61.0.*at most 60"),
    ],
)
def test_settings_outside_their_limits(kind, settings, words) -> None:
    with pytest.raises(ConfigError, match=words):
        kind(**settings)


@pytest.mark.parametrize(
    ("smoother", "name"),
    [
        (FourierSeries(2.0, {"c": 3}), "harmonics"),
        (KalmanSmoother(sigma={"c": 1.0}), "sigma"),
        (SavitzkyGolay({"c": 1.0}), "window"),
        (Spline(sigma={"c": 1.0}), "sigma"),
        (Spline(factor={"c": 2.0}), "factor"),
    ],
)
def test_settings_of_a_joint_that_is_not_there(smoother, name) -> None:
    with pytest.raises(ConfigError, match=f"{name} names the joint 'c'; the log has others.*'a', 'b'"):
        smoother(LOG)
