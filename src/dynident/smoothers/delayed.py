"""Any smoother, with the motion taken a little later than the torque."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from dynident.errors import ConfigError
from dynident.log import Log, Motion
from dynident.parts import SMOOTHERS
from dynident.smoothers.smoother import Smoother

__all__ = ["Delayed", "undelayed"]


@dataclass(frozen=True)
class Delayed:
    """Smooth with ``smoother``, then pair each torque with the motion ``delay`` (s) later.

    Filters, buses and the drive's own loop let positions and torques be stamped at unequal ages. The torque is not
    touched: a shifted noisy signal is a filtered one.
    """

    smoother: Annotated[Smoother, SMOOTHERS]
    delay: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.delay):
            raise ConfigError(f"delay is {self.delay}: give a finite number of seconds.")

    def __call__(self, log: Log) -> Motion:
        """Smooth and shift; the samples whose motion lies outside the log leave the mask."""
        motion = self.smoother(log)
        told = {**motion.smoothing, "delay": f"{1e3 * self.delay:.3g} ms"}
        return replace(motion.delayed(self.delay), smoothing=told)


def undelayed(smoother: Smoother) -> Smoother:
    """Return the smoother whose motion belongs to the stamps of the positions."""
    return undelayed(smoother.smoother) if isinstance(smoother, Delayed) else smoother
