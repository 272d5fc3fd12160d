"""The clock of the stamps: a rate that was assumed makes all velocities and accelerations too large or too small."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks import robot_notes
from dynident.checks.case import Case
from dynident.checks.finding import Topic
from dynident.checks.misfit import Misfit
from dynident.checks.suspect import Others, Suspect

__all__ = ["clock_suspect"]

Array = NDArray[np.float64]
STEP = 1e-5  # of the logarithm, of the difference
LARGEST = 1.0  # natural logarithm of the factor
ORDER = 5  # stamps are wrong less often than robot files


def clock_suspect() -> Suspect:
    """Return the clock, as the logarithm of true seconds per stamped one.

    Rotors and bodies take up a factor of all accelerations, but gravity and friction that falls off do not change.
    """

    def corrected(case: Case, value: float) -> Case:
        rate = float(np.exp(-value))
        return replace(case, dq=rate * case.dq, ddq=rate**2 * case.ddq, dddq=rate**3 * case.dddq)

    def derivative(fit: Misfit) -> Array:
        return np.asarray((corrected(fit.case, STEP).torque(fit.theta) - fit.torque) / STEP)

    def note(value: float, std: float, share: float, others: Others) -> robot_notes.WrongValue:
        factor = float(np.exp(value))
        return robot_notes.ClockWrong(factor, factor * std, share, others)

    return Suspect(None, Topic.CLOCK, derivative, corrected, note, LARGEST, ORDER, corrected)
