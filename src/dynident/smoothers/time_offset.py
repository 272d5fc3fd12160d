"""Any smoother, with its motion shifted in time against the torque."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.errors import ConfigError, called
from dynident.log import Log, Motion
from dynident.smoothers.smoother import Smoother, as_used

__all__ = ["TimeShifted", "unshifted"]


@dataclass(frozen=True)
class TimeShifted:
    """Smooth with ``smoother``, then pair each torque with the motion ``time_offset`` (s) later.

    Filters, buses and drives delay positions and torques by different times. The torque is not shifted, because
    interpolating a noisy signal filters it.
    """

    smoother: Smoother
    time_offset: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.time_offset):
            raise ConfigError(f"time offset is {self.time_offset}: give a finite number of seconds.")

    def __call__(self, log: Log) -> Motion:
        """Smooth and shift; samples whose motion lies outside the log are masked out."""
        motion = called(self.smoother, log, Motion)
        smoothing = {**motion.smoothing, "time offset": f"{1e3 * self.time_offset:.3g} ms"}
        return replace(motion.shifted(self.time_offset), smoothing=smoothing)

    def as_used(self, motion: Motion) -> TimeShifted:
        """Return the same shift of the smoother as it was used for a motion."""
        return TimeShifted(as_used(self.smoother, motion), self.time_offset)


def unshifted(smoother: Smoother) -> Smoother:
    """Return the smoother without its time offset."""
    return unshifted(smoother.smoother) if isinstance(smoother, TimeShifted) else smoother
