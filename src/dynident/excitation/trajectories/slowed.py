"""A trajectory at a share of its speed: the same path, for a first run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.excitation.trajectories.trajectory import Course, Trajectory

__all__ = ["Slowed", "slowed"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Slowed:
    """A ``course`` that takes ``times`` as long: dq, ddq and the jerk are less by times, its square and its cube."""

    course: Course
    times: float

    @property
    def duration(self) -> float:
        """Its length (s)."""
        return self.times * self.course.duration

    def states(self, t: Array, /) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        whole = self.course.duration
        found = self.course.states(np.clip(np.asarray(t, dtype=float) / self.times, 0.0, whole))
        return found / self.times ** np.arange(4.0)[:, None, None]


def slowed(trajectory: Trajectory, times: float) -> Trajectory:
    """Return the same path, ``times`` as long; ConfigError where that is shorter."""
    if not times >= 1:
        raise ConfigError(f"a trajectory cannot be slowed {times:g} times; give a number of at least 1.")
    return replace(
        trajectory, pieces=tuple(replace(one, course=Slowed(one.course, times)) for one in trajectory.pieces)
    )
