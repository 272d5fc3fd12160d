"""The gain of one joint's torque against those of the others, which share inertial parameters with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks import robot_notes
from dynident.checks.case import Case
from dynident.checks.finding import Topic
from dynident.checks.misfit import Misfit
from dynident.checks.suspect import Others, Suspect
from dynident.models import Model

__all__ = ["gain_suspects"]

Array = NDArray[np.float64]
LARGEST_GAIN = 3.0  # natural logarithm of a gain: a factor of 20
ORDER = 1


def gain_suspects(model: Model) -> list[Suspect]:
    """Return the gain of each joint, as its logarithm, the others being right; none for one joint."""
    names = [joint.name for joint in model.joints]
    return [_gain(model, j, name) for j, name in enumerate(names) if len(names) > 1]


def _gain(model: Model, j: int, name: str) -> Suspect:
    def derivative(fit: Misfit) -> Array:
        column = np.zeros_like(fit.predicted)
        column[:, j] = fit.torque[:, j]
        return column

    def corrected(case: Case, value: float) -> Case:
        factor = np.where(np.arange(len(model.joints)) == j, np.exp(value), 1.0)
        return replace(case, gain=case.gain * factor)

    def note(value: float, std: float, share: float, others: Others) -> robot_notes.WrongValue:
        factor = float(np.exp(value))
        return robot_notes.TorqueGain(factor, factor * std, share, others)

    return Suspect(name, Topic.GAIN, derivative, corrected, note, LARGEST_GAIN, ORDER)
