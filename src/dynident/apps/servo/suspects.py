"""What of a servo arm is given and yet contradicts the log: gains, masses and encoder offsets, tested at a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dynident.apps.servo.fit import ServoFit, correlated_sum, joint_scale, sensitivity
from dynident.apps.servo.plant import ServoPlant
from dynident.apps.servo.start import SmoothLog
from dynident.apps.servo.values import Entry, Quantity
from dynident.runtime.arrays import Array

MIN_GAIN = 0.05  # share of the squared error that an entry must explain
MIN_SCORE = 3.0  # standard errors of its score, correlated over time
MIN_OWN_SHARE = 1e-4  # of its effect that no fitted entry has
# of the logarithm, and rad
MIN_CHANGES = {Quantity.KP: 0.03, Quantity.MASS: 0.05, Quantity.OFFSET: 3e-3, Quantity.COMMAND_OFFSET: 3e-3}


def suspect_entries(plant: ServoPlant, motions: Sequence[SmoothLog], fit: ServoFit) -> dict[Entry, float]:
    """Return given entries that the log contradicts, the one that explains most first, with their proposed values.

    They are chosen one after the other from the linearised problem, each beside those before it.
    """
    joints = range(len(plant.joints))
    candidates = [Entry(quantity, k) for quantity in MIN_CHANGES for k in joints]
    candidates = [entry for entry in candidates if entry not in fit.entries and _matters(plant, fit, entry)]
    slopes = sensitivity(plant, motions, fit.values, candidates, fit.residuals)
    step = float(np.median(np.diff(motions[0].log.t)))

    def accepts(k: int, change: float) -> bool:
        return abs(change) > MIN_CHANGES[candidates[k].quantity]

    chosen, shifts, _ = choose_columns(fit, slopes, step, MIN_GAIN, MIN_SCORE, accepts)
    entries = [candidates[k] for k in chosen]
    moved = fit.values.moved(entries, np.clip(shifts, -0.7, 0.7))
    return {entry: moved.entry(entry) for entry in entries}


def choose_columns(
    fit: ServoFit, slopes: Array, step: float, min_gain: float, min_score: float, accepts: Callable[[int, float], bool]
) -> tuple[list[int], Array, float]:
    """Return which of the ``slopes`` (N', n, q) explain residuals of a fit beside its entries, their changes, and the
    share of the squared error that they explain.

    They are chosen one after the other, the best first, as long as each explains ``min_gain``, its change is accepted,
    and its score is ``min_score`` standard errors, correlated over time; samples are ``step`` s apart.
    """
    scale = joint_scale(fit.residuals)
    weighted = fit.residuals / scale
    columns = (np.concatenate([fit.sensitivity, slopes], axis=-1) / scale[:, None]).reshape(weighted.size, -1)
    p = len(fit.entries)
    fitted, total_gain = list(range(p)), 0.0
    while True:
        base = columns[:, fitted]
        rest = weighted.ravel() - base @ np.linalg.lstsq(base, weighted.ravel(), rcond=None)[0]
        gains = {}
        for k in range(p, columns.shape[1]):
            own = columns[:, k] - base @ np.linalg.lstsq(base, columns[:, k], rcond=None)[0]
            size = float(own @ own)
            if k in fitted or size <= MIN_OWN_SHARE * float(columns[:, k] @ columns[:, k]):
                continue
            change = -float(own @ rest) / size
            score = (own * rest).reshape(weighted.shape).sum(axis=1)
            spread = np.sqrt(max(correlated_sum(score[:, None], step)[0, 0], 1e-300))
            if abs(score.sum()) > min_score * spread and accepts(k - p, change):
                gains[k] = change**2 * size / float(rest @ rest)
        best = max(gains, key=lambda k: gains[k], default=None)
        if best is None or gains[best] < min_gain:
            break
        total_gain += (1 - total_gain) * gains[best]
        fitted.append(best)
    changes = -np.linalg.lstsq(columns[:, fitted], weighted.ravel(), rcond=None)[0][p:]
    return [k - p for k in fitted[p:]], np.asarray(changes, dtype=float), total_gain


def _matters(plant: ServoPlant, fit: ServoFit, entry: Entry) -> bool:
    if entry.quantity is Quantity.KP:
        return not fit.values.takes_torque[entry.k]
    return entry.quantity is not Quantity.MASS or bool(plant.model.body_mass[plant.bodies[entry.k]] > 0)
