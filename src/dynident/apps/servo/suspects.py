"""What of a servo arm is given and yet contradicts the log: gains, masses and encoder offsets, tested at a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.apps.servo.fit import ServoFit, correlated_sum, joint_scale, sensitivity
from dynident.apps.servo.plant import ServoPlant
from dynident.apps.servo.start import SmoothLog
from dynident.apps.servo.values import Entry, Quantity

Array = NDArray[np.float64]
MIN_GAIN = 0.05  # share of the squared error that an entry must explain
MIN_SCORE = 3.0  # standard errors of its score, correlated over time
MIN_OWN_SHARE = 1e-4  # of its effect that no fitted entry has
MIN_CHANGES = {
    Quantity.KP: 0.03,
    Quantity.MASS: 0.05,
    Quantity.OFFSET: 3e-3,
    Quantity.COMMAND_OFFSET: 3e-3,
}  # of the logarithm, and rad


def suspect_entries(plant: ServoPlant, motions: Sequence[SmoothLog], fit: ServoFit) -> dict[Entry, float]:
    """Return given entries that the log contradicts, the one that explains most first, with their proposed values.

    They are chosen one after the other from the linearised problem, each beside those before it.
    """
    joints = range(len(plant.joints))
    candidates = [Entry(quantity, k) for quantity in MIN_CHANGES for k in joints]
    candidates = [entry for entry in candidates if entry not in fit.entries and _matters(plant, entry)]
    slopes = sensitivity(plant, motions, fit.values, candidates, fit.residuals)
    scale = joint_scale(fit.residuals)
    step = float(np.median(np.diff(motions[0].log.t)))
    weighted = fit.residuals / scale
    columns = (np.concatenate([fit.sensitivity, slopes], axis=-1) / scale[:, None]).reshape(weighted.size, -1)
    fitted = list(range(len(fit.entries)))
    chosen: list[int] = []
    while True:
        base = columns[:, fitted]
        rest = weighted.ravel() - base @ np.linalg.lstsq(base, weighted.ravel(), rcond=None)[0]
        gains = {}
        for k in range(len(fit.entries), columns.shape[1]):
            entry = candidates[k - len(fit.entries)]
            own = columns[:, k] - base @ np.linalg.lstsq(base, columns[:, k], rcond=None)[0]
            size = float(own @ own)
            if k in fitted or size <= MIN_OWN_SHARE * float(columns[:, k] @ columns[:, k]):
                continue
            change = -float(own @ rest) / size
            score = (own * rest).reshape(weighted.shape).sum(axis=1)
            spread = np.sqrt(max(correlated_sum(score[:, None], step)[0, 0], 1e-300))
            if abs(score.sum()) > MIN_SCORE * spread and abs(change) > MIN_CHANGES[entry.quantity]:
                gains[k] = change**2 * size / float(rest @ rest)
        best = max(gains, key=lambda k: gains[k], default=None)
        if best is None or gains[best] < MIN_GAIN:
            break
        fitted.append(best)
        chosen.append(best)
    if not chosen:
        return {}
    shifts = -np.linalg.lstsq(columns[:, fitted], weighted.ravel(), rcond=None)[0][-len(chosen) :]
    entries = [candidates[k - len(fit.entries)] for k in chosen]
    moved = fit.values.moved(entries, np.clip(shifts, -0.7, 0.7))
    return {entry: moved.entry(entry) for entry in entries}


def _matters(plant: ServoPlant, entry: Entry) -> bool:
    return entry.quantity is not Quantity.MASS or bool(plant.model.body_mass[plant.bodies[entry.k]] > 0)
