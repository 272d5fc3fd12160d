"""Torques that drives have low-passed: a time offset that is really the lag of a filter.

A filter of first order delays what is slow by its time constant, and a jump by less. On the same rows the regressor is
taken as the time offset says, and as the filter makes it, which is a mean over its past. A mean over the future, as the
filter would make it backwards, smooths as much: where friction is smooth around reversals, it explains as much.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.checks.motion_notes import LowPassed
from dynident.models import Model
from dynident.motion.log import Motion, stack_states, subsample
from dynident.regression import fitted_mask
from dynident.runtime import Finding, Severity
from dynident.runtime.arrays import Array

MIN_OFFSET, MAX_OFFSET = 4e-3, 0.1  # s: filters that lag by less do no harm, longer ones are buffers
MIN_STEPS = 1.0  # of the sampling: what is faster lies between two samples
LAG_RATIOS = (1.0, 1.2, 1.44)  # time constants over the offset, which is log(2) of one where friction jumps
QUANTILES = -np.log(1.0 - (np.arange(16) + 0.5) / 16)  # times of equal weight in the response, in time constants
MIN_SHARE, MIN_WARNING_SHARE = 0.1, 0.4  # share of the squared residual that the filter must explain
MAX_BACKWARD_RATIO = 0.7  # squared residual over that of the filter backwards
MAX_NUMBERS, MAX_SAMPLES = 4_000_000, 1000  # of the regressor, and of all motions, up to twice as many
FOLDS, MIN_BETTER_FOLDS = 5, 4  # consecutive parts of the data, and how many the filter must explain better


def low_pass_findings(
    model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None
) -> Iterator[Finding]:
    """Yield that all torques were low-passed, where this explains far more than the offset by which they are late."""
    offset = -motions[0].time_offset
    step = max(float(np.median(np.diff(motion.t))) for motion in motions)
    is_usual = max(MIN_OFFSET, MIN_STEPS * step) < offset < MAX_OFFSET
    if not is_usual or len({motion.time_offset for motion in motions}) > 1:
        return
    samples = min(MAX_SAMPLES, MAX_NUMBERS // (len(model.joints) * len(model.parameters)))
    pairs = list(zip(motions, subsample(motions, samples, 2 * max(LAG_RATIOS) * offset), strict=True))
    if any(len(rows) < 2 for _, rows in pairs):
        return
    tau = np.concatenate([motion.tau[rows] for motion, rows in pairs])
    keep = np.concatenate([fitted_mask(motion, min_speed, rows) for motion, rows in pairs])

    def regressor(shift: float) -> Array:
        return model.regressor(**stack_states([motion.shift(shift, rows) for motion, rows in pairs]))

    def filter_residual(lag: float, direction: int = 1) -> Array:
        Y = np.asarray(sum(regressor(direction * (offset - lag * x)) for x in QUANTILES) / len(QUANTILES))
        return _squared_residual(Y, tau, keep)

    unfiltered = _squared_residual(regressor(0.0), tau, keep)
    weight = 1.0 / np.maximum(unfiltered.sum(axis=0), 1e-300)
    lags = [ratio * offset for ratio in LAG_RATIOS]
    trials = [(lag, filter_residual(lag)) for lag in lags]
    lag, filtered = min(trials, key=lambda trial: float((trial[1] * weight).sum()))
    shares = 1.0 - (filtered * weight).sum(axis=0)
    folds = [float((part * weight).sum()) for part in np.array_split(unfiltered - filtered, FOLDS)]
    backward = min(float((filter_residual(lag, -1) * weight).sum()) for lag in lags)
    is_causal = (filtered * weight).sum() < MAX_BACKWARD_RATIO * backward
    if is_causal and shares.mean() > MIN_SHARE and np.count_nonzero(np.array(folds) > 0) >= MIN_BETTER_FOLDS:
        removed = tuple((x.name, float(y)) for x, y in zip(model.joints, shares, strict=True) if y > 0)
        note = LowPassed(1.0 / (2 * np.pi * lag), offset, float(shares.mean()), removed)
        yield Finding(note, severity=Severity.WARNING if shares.max() > MIN_WARNING_SHARE else Severity.INFO)


def _squared_residual(Y: Array, tau: Array, keep: NDArray[np.bool_]) -> Array:
    """Return the squared residual (M, n) of least squares, where each joint counts by its own; 0 where none counts."""
    size = np.maximum(np.sqrt(np.mean(tau**2, axis=0)), 1e-300)
    weight = 1.0 / size
    for _ in range(2):
        X, y = (Y * (weight * keep)[:, :, None]).reshape(-1, Y.shape[2]), (tau * weight * keep).ravel()
        scale = np.linalg.norm(X, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        residual = (tau - Y @ (np.linalg.lstsq(X / scale, y)[0] / scale)) * keep
        weight = 1.0 / np.maximum(np.sqrt(np.mean(residual**2, axis=0)), 1e-9 * size)
    return np.asarray(np.square(residual))
