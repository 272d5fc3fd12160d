"""What a motion may reach: limits of the joints, less a margin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["JointLimits", "MotionLimits", "limits_of"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointLimits:
    """Limits that a user gives for one joint, None where the robot file or a rule says them: rad, rad/s, ... or m."""

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    torque: float | None = None


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of n joints, the margin taken off: ``lower`` and ``upper`` (rad, m), ``velocity``, ``acceleration``,
    ``jerk`` (per s, s^2, s^3) and ``torque`` (N m, N), each (n), infinite where there is none.

    ``by_rule`` names the quantities of each joint that neither the file nor the user gives, and a stated rule has made.
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    torque: Array
    by_rule: Mapping[str, tuple[str, ...]]

    __repr__ = brief


def limits_of(model: Model, given: Mapping[str, JointLimits] | None = None, margin: float = 0.1) -> MotionLimits:
    """Return the limits of a model's joints: as given, else of its file, else by rule; ``margin`` is the share of each
    range that is kept free."""
    raise NotImplementedError
