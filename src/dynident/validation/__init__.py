"""How well a model predicts: torque errors, tests of residuals, robust standard errors, free simulations."""

from dynident.validation.free_run import Broken, CascadePD, Driver, Failure, FreeRun, RunsAway, Singular, free_run
from dynident.validation.hac import bandwidth, robust_covariance
from dynident.validation.prediction import SEED, LogValidation, check_mass, relative_error, validate
from dynident.validation.residuals import (
    LOW,
    Cause,
    FrictionLevel,
    HighFrequency,
    LowFrequency,
    ResidualTest,
    Reversals,
    Ripple,
    autocorrelation,
    decorrelation,
    ljung_box,
    residual_test,
)

__all__ = [
    "LOW",
    "SEED",
    "Broken",
    "CascadePD",
    "Cause",
    "Driver",
    "Failure",
    "FreeRun",
    "FrictionLevel",
    "HighFrequency",
    "LogValidation",
    "LowFrequency",
    "ResidualTest",
    "Reversals",
    "Ripple",
    "RunsAway",
    "Singular",
    "autocorrelation",
    "bandwidth",
    "check_mass",
    "decorrelation",
    "free_run",
    "ljung_box",
    "relative_error",
    "residual_test",
    "robust_covariance",
    "validate",
]
