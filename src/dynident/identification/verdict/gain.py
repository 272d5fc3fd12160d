"""What a next step may gain: points of the error on the log that is judged."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynident.identification.result import Identification
from dynident.validation import LogValidation

__all__ = ["WORTH", "judged_log", "points"]

WORTH = 0.01  # share of the error that a step must gain


def judged_log(found: Identification) -> LogValidation:
    """Return the held-out log with the largest unfiltered error; the training log, where none was held out."""
    held = [log for log in found.validations if log.role == "validation"]
    return max(held or found.validations, key=lambda log: np.nan_to_num(log.errors.relative_error, nan=-1.0))


def points(log: LogValidation, removed: Mapping[str, float]) -> float | None:
    """Return by how many points the error of a log falls if the mean squared residuals of joints do by ``removed``
    ((N m)^2, N^2), to no less than the noise of the sensors; None where that is nothing, or no number."""
    errors = log.errors
    squares = {joint: size**2 for joint, size in errors.rmse.items()}
    least = {joint: errors.sensor_noise.get(joint, 0.0) ** 2 for joint in squares}
    less = sum(min(max(removed.get(joint, 0.0), 0.0), max(size - least[joint], 0.0)) for joint, size in squares.items())
    total = sum(squares.values())
    if not (total > 0 and less > 0 and np.isfinite(errors.relative_error)):
        return None
    return float(errors.relative_error * (1.0 - np.sqrt(1.0 - less / total)))
