"""Gains of motor currents, or of torques in unknown units, from the gravity and inertia of the robot file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.checks.torque import STRONG, agreement
from dynident.log import Motion
from dynident.models import Model

__all__ = ["RelativeGain", "relative_gains"]

BLOCKS = 10  # of the time, left out in turn for the standard error
UNSURE = 0.2  # standard error over gain, from which a gain is not given


@dataclass(frozen=True)
class RelativeGain:
    """What a recorded value is to be multiplied with to be a torque (N m or N) of the file's bodies, and its standard
    error by the jackknife over ten blocks of time; what errors of the file's masses add is not in it.
    """

    value: float
    std: float


def relative_gains(model: Model, motions: Sequence[Motion]) -> dict[str, RelativeGain]:
    """Return by joint the gain with which the torque of the file's bodies agrees with what ``tau`` of the motions has.

    That is fitted joint by joint as a multiple of the torque of the file's inertias, with rotor inertia, viscous and
    Coulomb friction and an offset beside it. Joints are left out whose motion does not show it: where correlation (with
    the rest projected out) is below 0.85, or the standard error over a fifth. All are where the file has no inertias.
    """
    whole = agreement(model, motions)
    parts = [agreement(model, [_without(motion, k) for motion in motions]) for k in range(BLOCKS)]
    found = {}
    for j, one in enumerate(whole):
        scales = np.array([part[j].scale for part in parts])
        if not abs(one.correlation) > STRONG or not np.isfinite(scales).all() or not scales.all():
            continue
        gains = 1.0 / scales
        std = float(np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((gains - gains.mean()) ** 2)))
        if std < UNSURE / abs(one.scale):
            found[one.joint] = RelativeGain(1.0 / one.scale, std)
    return found


def _without(motion: Motion, block: int) -> Motion:
    """Return the motion without one of the blocks of its time."""
    at = np.floor(BLOCKS * np.arange(len(motion)) / len(motion))
    return replace(motion, mask=motion.mask & (at != block))
