"""How the base is mounted: the direction of gravity by the torques, where they contradict the robot file clearly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.estimators import Estimate, Estimator, Problem
from dynident.identification.time_offset import training_error
from dynident.models import Model
from dynident.motion.log import Motion
from dynident.regression import EVERYTHING, Regression, Selection
from dynident.runtime import ConfigError, call_part

MIN_LEVEL_ERROR = 5.0  # %, of the training, below which the base is as the robot file has it
MAX_ERROR_RATIO = 0.5  # of the errors with the best direction and with that of the file
MIN_RIVAL_RATIO = 1.2  # of the errors with the second best direction and with the best
# rotations (rad) about x and y that turn the base onto each side, and over
MOUNTINGS = tuple((np.pi / 2 * x, np.pi / 2 * y) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1), (2, 0)))


def tilt_base(model: Model, x: float, y: float) -> Model:
    """Return the model on a base that is tilted by x and y (rad) about the axes of its root link.

    Raises ConfigError where no term of the model has gravity.
    """
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_rotvec((-x, -y, 0.0))
    if not any(term.gravity is not None for term in model.terms):
        raise ConfigError(f"{model.name}: no term has a gravity that could be rotated; only robot files have one.")
    return model.with_gravity(rotation.apply)


def has_gravity(model: Model) -> bool:
    """Return whether any term has a gravity that a tilt would rotate."""
    return any(any(term.gravity or ()) for term in model.terms)


def find_mounting(
    model: Model, motions: Sequence[Motion], estimator: Estimator, selection: Selection = EVERYTHING
) -> tuple[float, float] | None:
    """Return the rotations (rad) about x and y that turn the base as it is mounted; None where the file has it right.

    Tried are the five sides on which a robot can be mounted but the one assumed, each with a fit by the estimator. One
    is taken where it halves the training error, and no other comes near; the file's is never doubted where it explains
    the torque to 5 %. Raises the errors of ``Regression`` and the estimator.
    """
    gravity = {term.gravity for term in model.terms if term.gravity is not None and any(term.gravity)}
    if len(gravity) != 1 or any(next(iter(gravity))[:2]):  # a gravity that the user has set
        return None

    def error_of(mounting: tuple[float, float]) -> float:
        turned_model = tilt_base(model, *mounting)
        regression = Regression(turned_model, tuple(motions), selection.unfiltered)
        estimate = call_part(estimator.quick(), Problem(turned_model, regression.motions, regression), Estimate)
        return training_error(regression.triangular_factors, estimate.value)

    level = error_of((0.0, 0.0))
    if level < MIN_LEVEL_ERROR:
        return None
    errors = {mounting: error_of(mounting) for mounting in MOUNTINGS}
    best, second = sorted(errors, key=lambda mounting: errors[mounting])[:2]
    is_clear = errors[best] < MAX_ERROR_RATIO * level and errors[second] > MIN_RIVAL_RATIO * errors[best]
    return best if is_clear else None
