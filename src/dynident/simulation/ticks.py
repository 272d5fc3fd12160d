"""The times at which a controller works: those of its references, where these are more than the samples of a log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.log import Controller, Motion
from dynident.regression import stretches
from dynident.simulation.controllers import HasTimes

__all__ = ["Ticks", "longest", "ticks"]

Array = NDArray[np.float64]
SAME = 0.01  # of a step: times that are as near are the same


@dataclass(frozen=True, eq=False)
class Ticks:
    """A ``motion`` whose ``rows`` are the times at which a controller works; ``at`` (K) are those of the log's samples
    among these."""

    motion: Motion
    rows: slice
    at: NDArray[np.intp]

    __repr__ = brief


def longest(motion: Motion) -> slice:
    """Return the longest stretch of usable samples, empty where none is usable."""
    return max(stretches(motion.mask), key=lambda one: one.stop - one.start, default=slice(0, 0))


def ticks(motion: Motion, controller: Controller | None, rows: slice) -> Ticks:
    """Return samples ``rows`` of a motion at the times of a controller's references: a drive is often faster than its
    log.

    Between samples the motion is interpolated linearly; only its start matters to a simulation. It stays as it is where
    the controller has no times, no more than the log, or not those of the log among them.
    """
    plain = Ticks(motion, rows, np.arange(rows.stop - rows.start))
    if not isinstance(controller, HasTimes) or len(controller.t) < 2 or rows.stop - rows.start < 2:
        return plain
    logged = motion.t[rows]
    step = float(np.diff(controller.t).min())
    t = controller.t[(controller.t > logged[0] - SAME * step) & (controller.t < logged[-1] + SAME * step)]
    at = np.clip(np.searchsorted(t, logged - SAME * step), 0, max(len(t) - 1, 0))
    if len(t) <= len(at) or (np.abs(t[at] - logged) > SAME * step).any():
        return plain
    q, dq, ddq, tau = (
        np.column_stack([np.interp(t, motion.t, one) for one in columns.T])
        for columns in (motion.q, motion.dq, motion.ddq, motion.tau)
    )
    fine = Motion(t, q, dq, ddq, tau, motion.joints, np.ones(len(t), dtype=bool), motion.source)
    return Ticks(fine, slice(0, len(t)), at)
