"""Parallel filtering: the low-pass and decimation that torque and regressor go through alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.filters import butterworth, slowest_pole, zero_phase
from dynident.log import Motion
from dynident.smoothers import cutoff_complaint
from dynident.splines import stretches

__all__ = ["HIGHEST_ORDER", "ParallelFilter"]

Array = NDArray[np.float64]
HIGHEST_ORDER = 12  # order of a digital filter: poles of higher ones are lost in rounding


@dataclass(frozen=True)
class ParallelFilter:
    """Parallel filtering: the same zero-phase low-pass and decimation for the torque and every regressor column.

    The relation tau = Y theta holds exactly after a linear filter. ``decimate`` keeps every k-th sample; ``cutoff``
    (Hz) is that of the Butterworth filter of ``order``, applied forward and backward; None takes 0.8 of the Nyquist
    frequency after decimation. Reference: Gautier and Poignet (2000), cited by the article.

    >>> import dynident as dy
    >>> dy.ParallelFilter(decimate=10, cutoff=20.0)
    ParallelFilter(decimate=10, cutoff=20.0, order=4)
    """

    decimate: int = 1
    cutoff: float | None = None
    order: int = 4

    def __post_init__(self) -> None:
        whole = all(isinstance(number, (int, np.integer)) and number >= 1 for number in (self.decimate, self.order))
        if not whole or self.order > HIGHEST_ORDER or not (self.cutoff is None or self.cutoff > 0):
            raise ConfigError(
                f"parallel filter: decimate = {self.decimate} must be a whole number from 1, order = {self.order} one "
                f"from 1 to {HIGHEST_ORDER}, and cutoff = {self.cutoff} positive (Hz)."
            )
        if self.decimate == 1 and self.cutoff is None:
            raise ConfigError("parallel filter: give decimate > 1, a cutoff in Hz, or both.")

    def sections(self, motion: Motion) -> Array:
        """Return the filter's second-order sections for the mean rate of a motion."""
        cutoff, of = self.cutoff_at(motion), "" if self.cutoff else f" for decimate = {self.decimate},"
        if wrong := cutoff_complaint(f"the parallel filter's cut-off{of}", cutoff, motion.t):
            raise ConfigError(f"{motion.source}: {wrong}")
        return butterworth(self.order, cutoff, _rate(motion))

    def cutoff_at(self, motion: Motion) -> float:
        """Return the cut-off (Hz) for a motion."""
        return self.cutoff or 0.4 * _rate(motion) / self.decimate

    def filtered(self, motion: Motion, channels: Sequence[str] = ("q", "dq", "ddq", "tau")) -> Motion:
        """Return a motion with its ``channels`` filtered in each stretch of usable samples, and not decimated."""
        sections = self.sections(motion)
        series = {name: getattr(motion, name).copy() for name in channels}
        for part in stretches(motion.mask):
            for x in series.values() if part.stop - part.start > 1 else ():
                x[part] = self.apply(sections, x[part])
        for x in series.values():
            x.flags.writeable = False  # no copy is made then
        return replace(motion, **series)

    def pad(self, sections: Array) -> int:
        """Return the number of samples in which the filter's response decays to about 1e-12."""
        slowest = max(slowest_pole(sections), 0.1)  # a pole at zero has no logarithm
        return int(np.ceil(np.log(1e-12) / np.log(slowest)))

    def apply(self, sections: Array, x: Array, axis: int = 0) -> Array:
        """Return x filtered at all N samples of an axis, the first, not yet decimated; fastest along the last one."""
        return zero_phase(sections, x, min(3 * self.order, x.shape[axis] - 1), axis)


def _rate(motion: Motion) -> float:
    return 1.0 / float(np.diff(motion.t).mean())
