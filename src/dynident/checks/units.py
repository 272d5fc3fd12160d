"""Units that a log's rate, speeds and ranges cannot have: of the stamps, of sliding joints, of angles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks import log_notes as notes
from dynident.checks.finding import Finding, Topic
from dynident.errors import Severity
from dynident.estimators.linear import solve
from dynident.log import Log, Motion, thinned
from dynident.models import Model
from dynident.regression import Regression

__all__ = ["joint_errors", "least_error", "length_unit", "radian_findings", "thin", "time_unit"]

Array = NDArray[np.float64]

FACTORS = (1e-3, 1e-6, 1e-9, 1e3, 1e6, 1e9)
RATES = (20.0, 5e4)  # Hz, of recordings of robots
SLOWEST, FASTEST = 6.0, 1e5  # Hz: beyond, a unit is suspected
SPEEDS = (0.01, 40.0)  # rad/s, m/s, of motions that show dynamics
FAR, FAST = 20.0, 20.0  # m, m/s: beyond, a length is in millimetres
NARROW = 0.3  # rad: where all joints move less, their angles may be radians declared as degrees
BETTER = 0.95  # of the error: a smaller one tells the unit
SAMPLES = 3000  # of all motions, for a fit that only compares


def time_unit(log: Log) -> Iterator[Finding]:
    """Yield an error where rate and speeds are implausible, and another unit of time makes both usual."""
    step = float(np.median(np.diff(log.t)))
    speed = float(np.max([_speed(log.t, q) for q in log.q.T]))
    for factor in FACTORS if 1 / step < SLOWEST or 1 / step > FASTEST else ():
        usual = RATES[0] <= 1 / (step * factor) <= RATES[1]
        if usual and SPEEDS[0] <= speed / factor <= SPEEDS[1] and not SPEEDS[0] * 5 <= speed <= SPEEDS[1]:
            yield Finding(Severity.ERROR, None, notes.WrongTimeUnit(1 / step, speed, factor), Topic.TIME_UNIT)
            return


def _speed(t: Array, q: Array) -> float:
    """Return the 99th percentile of the speed over a few samples."""
    lag = min(5, len(t) - 1)
    return float(np.percentile(np.abs(q[lag:] - q[:-lag]) / (t[lag:] - t[:-lag]), 99))


def length_unit(joint: str, t: Array, q: Array) -> Iterator[Finding]:
    """Yield a warning where a sliding joint moves as far, or as fast, as if it were in millimetres."""
    span, speed = float(np.ptp(q)), _speed(t, q)
    if span > FAR or speed > FAST:
        yield Finding(Severity.WARNING, joint, notes.PerhapsMillimetres(span, speed), Topic.MILLIMETRES)


def radian_findings(few: Regression) -> Iterator[Finding]:
    """Yield where all angles are small, and as degrees that should have been radians explain the torque far better."""
    angles = np.array([joint.kind == "revolute" for joint in few.model.joints])
    spans: Array = np.max([np.ptp(one.q, axis=0) for one in few.motions], axis=0)
    if not angles.any() or spans[angles].max() > NARROW:
        return
    factor = np.where(angles, 180 / np.pi, 1.0)
    large = tuple(replace(one, q=one.q * factor, dq=one.dq * factor, ddq=one.ddq * factor) for one in few.motions)
    before, after = least_error(few), least_error(replace(few, motions=large))
    if after < BETTER * before:
        note = notes.PerhapsRadians(float(spans[angles].max()), before, after)
        yield Finding(Severity.WARNING, None, note, Topic.RADIANS)


def thin(model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None) -> Regression:
    """Return the regression of a few samples of motions, enough to compare fits."""
    return Regression(model, thinned(motions, max(SAMPLES, 3 * len(model.parameters))), min_speed=min_speed)


def joint_errors(regression: Regression) -> Array:
    """Return the relative error (n), in %, of least squares that weighs each joint by the size of its torque; zero for
    a joint without torque."""
    factors = regression.triangular_factors
    size = np.square(factors.factors[:, :, -1]).sum(axis=1)
    size[size == 0] = np.inf
    return np.asarray(100.0 * np.sqrt(factors.residual(solve(factors.stacked(1 / np.sqrt(size))).value) / size))


def least_error(regression: Regression) -> float:
    """Return the root mean square of ``joint_errors`` over the joints that have a torque."""
    torque = regression.triangular_factors.factors[:, :, -1].any(axis=1)
    return float(np.sqrt(np.square(joint_errors(regression)).sum() / max(int(np.count_nonzero(torque)), 1)))
