"""The noise floor of a residual: what the sensors allow, by another pass of the motion or by white noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.motion.filters import autocorrelation
from dynident.regression.groups import repeated_rows
from dynident.runtime.arrays import Array
from dynident.validation.residuals import LOW_FREQUENCY, Cause, HighFrequency, decorrelation

if TYPE_CHECKING:
    from dynident.validation.prediction import LogValidation

Index = NDArray[np.intp]
AT_FLOOR = 1.15  # times what the sensors allow: up to here a residual is at the noise floor
QUANTILE = 1.645  # standard errors that leave 5 % of a normal distribution above
# of the scatter, the most by which predicted torques of two passes may differ: else it is another motion
MAX_PREDICTION_RATIO = 0.5
MAX_OTHER_LOGS = 5  # other logs in which a motion is sought
MIN_INDEPENDENT_SAMPLES = 30  # independent samples
MEDIAN_NOISE = 10.5  # N times the relative variance of the noise power from the median of fourth differences


class FloorOrigin(StrEnum):
    """How it is known what the sensors allow."""

    REPEATS = "repeats"
    WHITE = "white"


@dataclass(frozen=True)
class NoiseFloor:
    """What the sensors allow of one joint's residual on a log.

    ``size`` (N m, N) is the rms scatter, ``ratio`` the residual's rms over it, and ``upper`` its upper limit with 95 %
    confidence. ``origin`` tells how the size is known.
    """

    size: float
    ratio: float
    upper: float
    origin: FloorOrigin

    @property
    def is_reached(self) -> bool:
        """Whether it is at the noise floor: with 95 % confidence at most 1.15 times what the sensors allow."""
        return self.upper <= AT_FLOOR


def with_floors(validations: Sequence[LogValidation]) -> tuple[LogValidation, ...]:
    """Return validations, all with signals, each with the known noise floors of its joints."""
    return tuple(replace(validation, floors=_floors(validation, validations)) for validation in validations)


def _floors(validation: LogValidation, validations: Sequence[LogValidation]) -> dict[str, NoiseFloor]:
    """Return the floors by joint: by another pass in the log, else in another log, else by white noise."""
    floors: dict[str, NoiseFloor] = {}
    # the log itself first: another pass in it has the same conditions
    for candidate in (validation, *[log for log in validations if log is not validation][:MAX_OTHER_LOGS]):
        if (
            len(floors) < len(validation.motion.joints)
            and (rows := repeated_rows(validation.motion, candidate.motion)) is not None
        ):
            floors = {**_floors_of_passes(validation, candidate, *rows), **floors}
    return {
        **{joint: _white_floor(validation, joint, size) for joint, size in validation.errors.sensor_noise.items()},
        **floors,
    }


def _floors_of_passes(first: LogValidation, second: LogValidation, rows: Index, twins: Index) -> dict[str, NoiseFloor]:
    """Return the floors by joint from the residuals of two passes of a motion, at these samples."""
    floors = {}
    for j, (joint, rmse) in enumerate(first.errors.rmse.items()):
        speed, torque = first.motion.dq[rows, j], first.predicted_torque[rows, j]
        # offset, friction, viscous friction and gain, the changes that a drive makes when it warms up
        drift = np.column_stack([np.ones(len(rows)), np.sign(speed), speed, torque])
        a, b = _remove_drift(_joint_residual(first, j)[rows], _joint_residual(second, j)[twins], drift)
        floor = _floor_of_passes(a, b, rmse) if np.isfinite(rmse) else None
        prediction_change = float(
            np.mean(np.square(first.predicted_torque[rows, j] - second.predicted_torque[twins, j])) / 2
        )
        # torques that are predicted differently are of another motion, or the lag is wrong
        if floor is not None and prediction_change <= (MAX_PREDICTION_RATIO * floor.size) ** 2:
            floors[joint] = floor
    return floors


def _remove_drift(a: Array, b: Array, drift: Array) -> tuple[Array, Array]:
    """Return the residuals (M) of two passes without the drift in their difference, columns ``drift`` (M, k).

    Half of it is taken from each. The remaining difference is enlarged for what the fit takes of it by chance, by
    the number of independent samples.
    """
    size = np.linalg.norm(drift, axis=0)
    columns = drift / np.where(size > 0, size, 1.0)
    # only the difference of the passes is freed of drift: what both have in common counts as error of the model
    difference = a - b - columns @ np.linalg.lstsq(columns, a - b)[0]
    if not np.ptp(difference) > 0:
        return a, b
    # the fit takes a part of the scatter, too
    count = len(difference) / decorrelation(autocorrelation(difference))
    difference *= np.sqrt(count / max(count - drift.shape[1], 1.0))
    return (a + b + difference) / 2, (a + b - difference) / 2


def _floor_of_passes(a: Array, b: Array, rmse: float) -> NoiseFloor | None:
    """Return the floor of a residual of rms ``rmse`` from its parts a and b (M) of two passes; None if vague."""
    power = float(np.mean(a**2 + b**2)) / 2
    if not power > 0:
        return None
    # what both passes share is error of the model, the remainder scatter
    shared = float(np.mean(a * b)) / power
    error = _standard_error((a * b - shared * (a**2 + b**2) / 2) / power)
    if error is None or not shared < 1:
        return None
    size, max_shared = float(np.sqrt(power * (1 - shared))), shared + QUANTILE * error
    upper = rmse / size * float(np.sqrt((1 - shared) / (1 - max_shared))) if max_shared < 1 else float("inf")
    return NoiseFloor(size, rmse / size, upper, FloorOrigin.REPEATS)


def _white_floor(validation: LogValidation, joint: str, size: float) -> NoiseFloor:
    """Return the floor by white noise; the error of the noise and that of the residual's power add up."""
    ratio = validation.errors.rmse[joint] / size
    squares = np.square(_joint_residual(validation, validation.motion.joints.index(joint))[validation.motion.mask])
    error = _standard_error(squares / squares.mean() - 1.0) if squares.any() else 0.0
    relative_error = np.inf if error is None else np.sqrt(error**2 + MEDIAN_NOISE / len(squares))
    return NoiseFloor(size, ratio, float(ratio * np.sqrt(1 + QUANTILE * relative_error)), FloorOrigin.WHITE)


def _standard_error(parts: Array) -> float | None:
    """Return the standard error of the mean of a correlated series (N); None for fewer than 30 independent samples."""
    if len(parts) < MIN_INDEPENDENT_SAMPLES or not np.ptp(parts) > 0:
        return None
    count = len(parts) / decorrelation(autocorrelation(parts))
    return float(np.std(parts) / np.sqrt(count)) if count >= MIN_INDEPENDENT_SAMPLES else None


def _joint_residual(log: LogValidation, j: int) -> Array:
    return np.asarray(log.motion.tau[:, j] - log.predicted_torque[:, j])


def causes_text(causes: Sequence[Cause], floor: NoiseFloor | None = None) -> str:
    """Return the likely causes of a residual, an empty text where there are none.

    What lies above a known noise ``floor`` is not noise of the sensors; above a white one it may be coloured noise.
    """
    texts = list(map(str, causes))
    if floor is not None:
        coloured = ", or coloured noise" if floor.origin is FloorOrigin.WHITE else ""
        above = f"ripple, elasticity or a time offset{coloured} (mostly above {LOW_FREQUENCY:g} Hz)"
        texts = [above if isinstance(cause, HighFrequency) else str(cause) for cause in causes]
    return " and ".join(texts)
