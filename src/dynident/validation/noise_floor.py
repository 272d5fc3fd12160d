"""Whether a torque residual is at the noise floor: what the sensors allow, by the motion that repeats or white noise.

Where a motion repeats, no model tells the two passes apart: what their residuals a and b do not share is scatter, of
any colour, of power (a - b)^2 / 2. What they share, c = sum a b / sum (a^2 + b^2) / 2 of the power, is not (Box and
Draper's pure error and lack of fit). Nor is a change between the passes that an offset, friction or a gain makes, as
of a drive that warms up: it is removed first. Elsewhere the least that white noise leaves (``sensor_noise``) stands in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.filters import autocorrelation
from dynident.regression.repeat import repeated_rows
from dynident.validation.residuals import decorrelation

if TYPE_CHECKING:
    from dynident.validation.prediction import LogValidation

__all__ = ["AT_FLOOR", "FloorOrigin", "NoiseFloor", "with_floors"]

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
AT_FLOOR = 1.15  # times what the sensors allow: up to here a residual is at the noise floor
QUANTILE = 1.645  # standard errors that leave 5 % of a normal distribution above
ALIKE = 0.5  # of the scatter, the most by which predicted torques of two passes may differ: else it is another motion
MOST = 5  # other logs in which a motion is sought
FEWEST = 30  # independent samples
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
    def reached(self) -> bool:
        """Whether it is at the noise floor: with 95 % confidence at most 1.15 times what the sensors allow."""
        return self.upper <= AT_FLOOR


def with_floors(validations: Sequence[LogValidation]) -> tuple[LogValidation, ...]:
    """Return validations, all with signals, each with the noise floors of its joints that are known."""
    return tuple(replace(one, floors=_floors(one, validations)) for one in validations)


def _floors(one: LogValidation, every: Sequence[LogValidation]) -> dict[str, NoiseFloor]:
    """Return the floors by joint: by another pass in the log, else in another log, else by white noise."""
    found: dict[str, NoiseFloor] = {}
    for other in (one, *[log for log in every if log is not one][:MOST]):
        if len(found) < len(one.motion.joints) and (rows := repeated_rows(one.motion, other.motion)) is not None:
            found = {**_by_repeats(one, other, *rows), **found}
    return {**{joint: _white(one, joint, size) for joint, size in one.errors.sensor_noise.items()}, **found}


def _by_repeats(one: LogValidation, other: LogValidation, rows: Rows, twins: Rows) -> dict[str, NoiseFloor]:
    """Return the floors by joint from the residuals of two passes of a motion, at these samples."""
    found = {}
    for j, (joint, rmse) in enumerate(one.errors.rmse.items()):
        speed, torque = one.motion.dq[rows, j], one.predicted[rows, j]
        drift = np.column_stack([np.ones(len(rows)), np.sign(speed), speed, torque])
        a, b = _steady(_residual(one, j)[rows], _residual(other, j)[twins], drift)
        floor = _scatter(a, b, rmse) if np.isfinite(rmse) else None
        moved = float(np.mean(np.square(one.predicted[rows, j] - other.predicted[twins, j])) / 2)
        if floor is not None and moved <= (ALIKE * floor.size) ** 2:
            found[joint] = floor
    return found


def _steady(a: Array, b: Array, drift: Array) -> tuple[Array, Array]:
    """Return the residuals (M) of two passes without what their difference has of the columns of ``drift`` (M, k): half
    of it from each, and the rest made larger for what chance has of them, of as many samples as are independent."""
    size = np.linalg.norm(drift, axis=0)
    columns = drift / np.where(size > 0, size, 1.0)
    rest = a - b - columns @ np.linalg.lstsq(columns, a - b)[0]
    if not np.ptp(rest) > 0:
        return a, b
    count = len(rest) / decorrelation(autocorrelation(rest))
    rest *= np.sqrt(count / max(count - drift.shape[1], 1.0))
    return (a + b + rest) / 2, (a + b - rest) / 2


def _scatter(a: Array, b: Array, rmse: float) -> NoiseFloor | None:
    """Return the floor of a residual of rms ``rmse`` by its parts a and b (M) of two passes; None where it is vague."""
    power = float(np.mean(a**2 + b**2)) / 2
    if not power > 0:
        return None
    shared = float(np.mean(a * b)) / power
    error = _standard_error((a * b - shared * (a**2 + b**2) / 2) / power)
    if error is None or not shared < 1:
        return None
    size, most = float(np.sqrt(power * (1 - shared))), shared + QUANTILE * error
    upper = rmse / size * float(np.sqrt((1 - shared) / (1 - most))) if most < 1 else float("inf")
    return NoiseFloor(size, rmse / size, upper, FloorOrigin.REPEATS)


def _white(one: LogValidation, joint: str, size: float) -> NoiseFloor:
    """Return the floor by white noise; the error of the noise and that of the residual's power add up."""
    ratio = one.errors.rmse[joint] / size
    squares = np.square(_residual(one, one.motion.joints.index(joint))[one.motion.mask])
    error = _standard_error(squares / squares.mean() - 1.0) if squares.any() else 0.0
    own = np.inf if error is None else np.sqrt(error**2 + MEDIAN_NOISE / len(squares))
    return NoiseFloor(size, ratio, float(ratio * np.sqrt(1 + QUANTILE * own)), FloorOrigin.WHITE)


def _standard_error(parts: Array) -> float | None:
    """Return the standard error of the mean of a correlated series (N); None of fewer than 30 independent samples."""
    if len(parts) < FEWEST or not np.ptp(parts) > 0:
        return None
    count = len(parts) / decorrelation(autocorrelation(parts))
    return float(np.std(parts) / np.sqrt(count)) if count >= FEWEST else None


def _residual(log: LogValidation, j: int) -> Array:
    return np.asarray(log.motion.tau[:, j] - log.predicted[:, j])
