"""Dry friction, which may hold a joint with any torque up to its own: how slow a joint may be to be understood."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.trajectories.limits import MotionLimits
from dynident.models import HasSign

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["slowest"]

Array = NDArray[np.float64]
SLOW = 0.03  # of the velocity limit


def slowest(model: Model, limits: MotionLimits) -> Array:
    """Return the speed (n) below which a fit leaves out a joint's torque: 3 % of the velocity limit, zero without dry
    friction, which may hold the joint with any torque up to its own, and after which it moves on with a jerk."""
    state = np.zeros((1, len(limits.joints))), limits.velocity[None], np.zeros((1, len(limits.joints)))
    rubs = np.zeros(len(limits.joints), dtype=bool)
    for term in (one for one in model.terms if isinstance(one, HasSign)):
        rubs |= term.regressor(*state).any(axis=(0, 2))
    return np.where(rubs & np.isfinite(limits.velocity), SLOW * limits.velocity, 0.0)
