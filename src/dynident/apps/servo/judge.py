"""Rollouts of a servo arm beside recordings, and whether its model is good for simulation: judged by held-out ones."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from dynident.apps.servo.fit import SETTLING, WINDOW, split_into_windows, window_residuals
from dynident.apps.servo.plant import ServoLog, ServoPlant
from dynident.apps.servo.start import SmoothLog
from dynident.apps.servo.values import ServoValues
from dynident.motion.splines import grid_step, steady_noise
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

MAX_GOOD_ERROR, MAX_FAIR_ERROR = 0.02, 0.1  # of the spread of a joint's motion
NOISE_FACTOR = 2.0  # times the noise of the positions: a smaller error is not seen
MIN_NOISE = 1e-9  # of the largest position: its rounding


class ServoUse(StrEnum):
    """What the model of a servo arm is good for, the best first."""

    GOOD = "good for simulation"
    CARE = "simulate with care"
    NO = "do not use"


class ServoRollout(Noun):
    """A recording beside its simulation: ``simulated`` and ``nominal`` (N, n) positions from its first sample on.

    Errors (n) are root mean squares, rad or m: of the whole rollout, of the file's values, and of ``window_error``
    rollouts of 0.5 s from measured positions. Where torques are commanded all are of 0.5 s, from states that fit.
    ``noise`` (n) is that of the positions, ``spread`` (n) of the motion.
    """

    log: ServoLog
    role: str
    simulated: Array
    nominal: Array
    error: Array
    nominal_error: Array
    window_error: Array
    noise: Array
    spread: Array

    @property
    def use(self) -> ServoUse:
        """What the rollout speaks for."""
        floor, worst = NOISE_FACTOR * self.noise, np.maximum(self.error, self.window_error)
        if (worst <= np.maximum(floor, MAX_GOOD_ERROR * self.spread)).all():
            return ServoUse.GOOD
        return ServoUse.CARE if (worst <= np.maximum(floor, MAX_FAIR_ERROR * self.spread)).all() else ServoUse.NO


def position_noise(q: Array) -> Array:
    """Return the noise (n) of positions (N, n): what is white, and at least that of the counts of an encoder."""
    counts = np.nan_to_num([grid_step(column) for column in q.T])
    return np.asarray(np.maximum(steady_noise(q, MIN_NOISE), counts / np.sqrt(12)))


def roll_out(
    plant: ServoPlant, motion: SmoothLog, role: str, values: ServoValues, nominal: ServoValues
) -> ServoRollout:
    """Return a recording beside its simulation with the fitted and with the file's values, delay and all."""
    log = motion.log
    size = position_noise(log.q), log.q.std(axis=0)
    if values.takes_torque.any():
        simulated, before = (_in_windows(plant, motion, x) for x in (values, nominal))
        error = _rms(simulated - log.q)
        return ServoRollout(log, role, simulated, before, error, _rms(before - log.q), error, *size)
    simulated, before = (plant.rollout(x, log, speeds=motion.speeds)[0] for x in (values, nominal))
    later = log.t > log.t[0] + SETTLING
    first = min(SETTLING, log.t[-1] - log.t[0] - WINDOW)  # of a short recording, the end
    starts = np.searchsorted(log.t, np.arange(log.t[0] + first, log.t[-1] - WINDOW + 1e-6, WINDOW))
    stops = [min(int(np.searchsorted(log.t, log.t[k] + WINDOW)) + 1, len(log.t)) for k in starts]
    # measured speeds are unsure where positions are counts: those of the simulation are taken
    windows = plant.rollout(values, log, list(starts), stops, np.gradient(simulated, log.t, axis=0))
    misses = np.vstack([path - log.q[a:b] for path, a, b in zip(windows, starts, stops, strict=True)])
    errors = _rms((simulated - log.q)[later]), _rms((before - log.q)[later]), _rms(misses)
    return ServoRollout(log, role, simulated, before, *errors, *size)


def _in_windows(plant: ServoPlant, motion: SmoothLog, values: ServoValues) -> Array:
    """Return the positions (N, n) of rollouts of 0.5 s, from states that are nearest to the measured positions."""
    windows = split_into_windows(plant, motion, values).windows
    return motion.log.q + np.vstack([] if windows is None else window_residuals(plant, motion, windows, values))


def _rms(x: Array) -> Array:
    return np.asarray(np.sqrt((x**2).mean(axis=0)))


def verdict_of(rollouts: Sequence[ServoRollout]) -> ServoUse | None:
    """Return what a model is good for by its held-out rollouts, the worst of them; None where there is none."""
    uses = [rollout.use for rollout in rollouts if rollout.role == "validation"]
    return max(uses, key=list(ServoUse).index, default=None)
