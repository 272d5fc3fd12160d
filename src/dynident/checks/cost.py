"""What a cause costs: how far the torque of the fit as given is from that with the cause set right, where it matters.

The two are compared on the training motion at twice its speed: what is wrong but fits has been taken up by other
parameters, and only another motion shows it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks.case import Case
from dynident.checks.misfit import Misfit
from dynident.identification.verdict.unconstrained import FASTER

__all__ = ["Cost", "cost", "faster", "mean_square"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cost:
    """By how many % the torque differs at twice the speed: of ``all`` joints together, and of the worst ``joint``; and
    by how much the mean squared residual of each joint falls, (N m)^2 or N^2, where it falls.

    The value of one unknown that is six standard errors from zero has explained 1/36 of this by chance.
    """

    all: float
    joint: float
    removed: tuple[tuple[str, float], ...] = ()


def faster(case: Case) -> Case:
    """Return the case on its own path at twice the speed; its torque is still the measured one."""
    dq, ddq, dddq = (FASTER**k * x for k, x in enumerate((case.dq, case.ddq, case.dddq), start=1))
    return replace(case, dq=dq, ddq=ddq, dddq=dddq, gain=1.0)


def cost(before: Misfit, after: Misfit) -> Cost:
    """Return by how much the torque at twice the speed differs between two fits, relative to the second."""
    right = _torque(after)
    change = _torque(before) - right
    size = np.linalg.norm(right, axis=0)
    joints = np.linalg.norm(change, axis=0) / np.where(size > 0, size, np.inf)
    whole = float(np.linalg.norm(change) / (np.linalg.norm(right) or np.inf))
    less = mean_square(before) - mean_square(after)
    removed = tuple((one.name, float(x)) for one, x in zip(before.case.model.joints, less, strict=True) if x > 0)
    return Cost(100.0 * whole, 100.0 * float(joints.max()), removed)


def mean_square(fit: Misfit) -> Array:
    """Return the mean squared residual (n) of the samples that count."""
    kept = fit.case.keep
    left = np.where(kept, fit.case.tau - fit.predicted, 0.0)
    return np.asarray(np.square(left).sum(axis=0) / np.maximum(kept.sum(axis=0), 1))


def _torque(fit: Misfit) -> Array:
    """Return the torque (M, n) of a fit at twice the speed, in the unit of the other joints where a gain was found."""
    added = sum((value * column for value, column in zip(fit.extra, fit.case.beyond, strict=False)), np.float64(0.0))
    return np.asarray(faster(fit.case).torque(fit.theta) + added / fit.case.gain)
