"""Courses of the programs: an arm that moves along a line at a constant speed, and one that stands."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Hold", "Sweep", "run_up"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hold:
    """An arm that stands in a ``pose`` (n) for a ``duration`` (s)."""

    duration: float
    pose: Array

    __repr__ = brief

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        out = np.zeros((4, len(t), len(self.pose)))
        out[0] = self.pose
        return out


def run_up(speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Return how long (s) the jerk acts, and then the full acceleration, on the way from rest to a speed; the jerk acts
    again for as long as before."""
    if speed * jerk < acceleration**2:
        return float(np.sqrt(speed / jerk)), 0.0
    return acceleration / jerk, speed / acceleration - acceleration / jerk


@dataclass(frozen=True, eq=False)
class Sweep:
    """An arm from rest in a ``pose`` (n) to rest, by ``distance`` times ``direction`` (n), at a constant ``speed`` in
    between; ``acceleration`` and ``jerk`` are the largest on the way to that speed and back, all along the direction.

    The distance is at least that of a run-up and a run-out.
    """

    pose: Array
    direction: Array
    distance: float
    speed: float
    acceleration: float
    jerk: float

    __repr__ = brief

    @property
    def duration(self) -> float:
        """Its length (s)."""
        return float(self._edges[-1])

    @property
    def cruise(self) -> float:
        """How long (s) the speed is constant."""
        ramp, steady = run_up(self.speed, self.acceleration, self.jerk)
        return max(0.0, abs(self.distance) / self.speed - 2 * ramp - steady)

    @property
    def end(self) -> Array:
        """The pose (n) in which it ends."""
        return np.asarray(self.pose + self.distance * self.direction)

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        t = np.asarray(t, dtype=float)
        k = np.clip(np.searchsorted(self._edges, t, side="right") - 1, 0, 6)
        out = np.zeros((4, len(t), len(self.pose)))
        out[0] = self.pose
        out += _after(self._begin[:, k], t - self._edges[k])[:, :, None] * self.direction
        return out

    @cached_property
    def _edges(self) -> Array:
        ramp, steady = run_up(self.speed, self.acceleration, self.jerk)
        return np.cumsum([0.0, ramp, steady, ramp, self.cruise, ramp, steady, ramp])

    @cached_property
    def _begin(self) -> Array:
        """The states (4, 7) along the direction, at the beginning of each part of constant jerk."""
        states = [np.zeros(4)]
        for sign, length in zip((1, 0, -1, 0, -1, 0, 1), np.diff(self._edges), strict=True):
            states[-1][3] = sign * np.copysign(self.jerk, self.distance)
            states.append(_after(states[-1][:, None], np.array([length]))[:, 0])
        return np.stack(states[:-1], axis=1)


def _after(state: Array, t: Array) -> Array:
    """Return states (4, N) a time t (N) later, at constant jerk."""
    q, dq, ddq, jerk = state
    return np.stack(
        [q + t * (dq + t * (ddq / 2 + t * jerk / 6)), dq + t * (ddq + t * jerk / 2), ddq + t * jerk, jerk + 0 * t]
    )
