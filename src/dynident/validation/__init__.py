"""How well a model predicts: torque errors, tests of residuals, robust standard errors, free simulations."""

from dynident.regression.repeat import REPEATED, Repeat, repeat_of
from dynident.validation.clusters import clustered_std
from dynident.validation.coloured import coloured_covariance, coloured_std, correlated_std
from dynident.validation.followed import HARMFUL, FollowTest, SmoothedAway, follow_tests, smoothed_away
from dynident.validation.free_run import Driver, FreeRun, RunSignals, free_run
from dynident.validation.hac import plain_std, robust_covariance
from dynident.validation.noise_floor import AT_FLOOR, FloorOrigin, NoiseFloor, with_floors
from dynident.validation.prediction import (
    SEED,
    LogValidation,
    Signals,
    TorqueErrors,
    check_mass,
    relative_error,
    relative_errors,
    validate,
)
from dynident.validation.residuals import (
    LOW,
    SLOW,
    Cause,
    FrictionLevel,
    HighFrequency,
    LowFrequency,
    ResidualTest,
    Reversals,
    Ripple,
    decorrelation,
    residual_test,
)
from dynident.validation.sensor_noise import sensor_noise

__all__ = [
    "AT_FLOOR",
    "HARMFUL",
    "LOW",
    "REPEATED",
    "SEED",
    "SLOW",
    "Cause",
    "Driver",
    "FloorOrigin",
    "FollowTest",
    "FreeRun",
    "FrictionLevel",
    "HighFrequency",
    "LogValidation",
    "LowFrequency",
    "NoiseFloor",
    "Repeat",
    "ResidualTest",
    "Reversals",
    "Ripple",
    "RunSignals",
    "Signals",
    "SmoothedAway",
    "TorqueErrors",
    "check_mass",
    "clustered_std",
    "coloured_covariance",
    "coloured_std",
    "correlated_std",
    "decorrelation",
    "follow_tests",
    "free_run",
    "plain_std",
    "relative_error",
    "relative_errors",
    "repeat_of",
    "residual_test",
    "robust_covariance",
    "sensor_noise",
    "smoothed_away",
    "validate",
    "with_floors",
]
