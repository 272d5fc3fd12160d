"""How well a model predicts: torque errors, tests of residuals, robust standard errors, free simulations."""

from dynident.validation.coloured_fit import ColouredFit, correlated_std
from dynident.validation.free_run import Driver, FreeRun, free_run
from dynident.validation.noise_floor import AT_FLOOR, FloorOrigin, NoiseFloor, causes_text, with_floors
from dynident.validation.prediction import (
    SEED,
    LogValidation,
    Signals,
    TorqueErrors,
    check_mass,
    predict_torque,
    relative_error,
    relative_errors,
    residual_text,
    sensor_noise,
    validate,
)
from dynident.validation.residuals import (
    MAX_LOST_ACCELERATION,
    SLOW_SPEED_SHARE,
    Cause,
    FollowTest,
    FrictionLevel,
    HighFrequency,
    LowFrequency,
    ResidualRipple,
    Reversals,
    SmoothedAway,
    decorrelation,
    follow_tests,
    residual_test,
    smoothing_losses,
)
from dynident.validation.standard_errors import clustered_std, plain_std, robust_covariance
