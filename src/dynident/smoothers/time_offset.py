"""Any smoother, with its motion shifted in time against the torque."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from annotated_types import Ge, Le

from dynident.errors import ConfigError, InputError, called
from dynident.log import Log, Motion
from dynident.smoothers.smoother import HasSubstitute, Smoother, as_used

__all__ = ["LONGEST_OFFSET", "TimeShifted", "unshifted"]

LONGEST_OFFSET = 60.0  # s


@dataclass(frozen=True)
class TimeShifted:
    """Smooth with ``smoother``, then pair each torque with the motion ``time_offset`` (s) later.

    Filters, buses and drives delay positions and torques by different times. The torque is not shifted, because
    interpolating a noisy signal filters it.
    """

    smoother: Smoother
    time_offset: Annotated[float, Ge(-LONGEST_OFFSET), Le(LONGEST_OFFSET)]

    def __post_init__(self) -> None:
        if not abs(self.time_offset) <= LONGEST_OFFSET:
            raise ConfigError(
                f"time offset is {self.time_offset} s: give a number from -{LONGEST_OFFSET:g} to {LONGEST_OFFSET:g}."
            )

    def __call__(self, log: Log) -> Motion:
        """Smooth and shift; samples whose motion lies outside the log are masked out."""
        return self.shifted(called(self.smoother, log, Motion))

    def shifted(self, motion: Motion) -> Motion:
        """Shift the motion that the smoother has made of a log."""
        shifted = motion.shifted(self.time_offset)
        if motion.mask.any() and not shifted.mask.any():
            raise InputError(
                f"{motion.source}: with a time offset (`delay`) of {self.time_offset:g} s no sample of its "
                f"{motion.t[-1] - motion.t[0]:.4g} s is left; give the true one, most often a few milliseconds."
            )
        smoothing = {**motion.smoothing, "time offset": f"{1e3 * self.time_offset:.3g} ms"}
        return replace(shifted, smoothing=smoothing)

    def as_used(self, motion: Motion) -> TimeShifted:
        """Return the same shift of the smoother as it was used for a motion."""
        return TimeShifted(as_used(self.smoother, motion), self.time_offset)

    def substitute(self) -> TimeShifted | None:
        """Return the same shift of what stands in for the smoother, where it has something."""
        other = self.smoother.substitute() if isinstance(self.smoother, HasSubstitute) else None
        return None if other is None else TimeShifted(other, self.time_offset)


def unshifted(smoother: Smoother) -> Smoother:
    """Return the smoother without its time offset."""
    return unshifted(smoother.smoother) if isinstance(smoother, TimeShifted) else smoother
