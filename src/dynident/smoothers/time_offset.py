"""Any smoother, with the motion taken a little later than the torque."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.errors import ConfigError
from dynident.log import Log, Motion
from dynident.smoothers.smoother import Smoother

__all__ = ["TimeShifted", "unshifted"]


@dataclass(frozen=True)
class TimeShifted:
    """Smooth with ``smoother``, then pair each torque with the motion ``time_offset`` (s) later.

    Filters, buses and the drive's own loop let positions and torques be stamped at unequal ages. The torque is not
    touched: a shifted noisy signal is a filtered one.
    """

    smoother: Smoother
    time_offset: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.time_offset):
            raise ConfigError(f"time offset is {self.time_offset}: give a finite number of seconds.")

    def __call__(self, log: Log) -> Motion:
        """Smooth and shift; the samples whose motion lies outside the log leave the mask."""
        motion = self.smoother(log)
        told = {**motion.smoothing, "delay": f"{1e3 * self.time_offset:.3g} ms"}
        return replace(motion.shifted(self.time_offset), smoothing=told)


def unshifted(smoother: Smoother) -> Smoother:
    """Return the smoother whose motion belongs to the stamps of the positions."""
    return unshifted(smoother.smoother) if isinstance(smoother, TimeShifted) else smoother
