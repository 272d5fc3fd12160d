"""Where along a trajectory an arm comes closest to itself or to an obstacle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.spaces.space import Distances, Steep
from dynident.excitation.trajectories.trajectory import Trajectory

__all__ = ["Nearest", "nearest"]

Array = NDArray[np.float64]
COARSE = 50.0  # Hz
PARTS, LEVELS = 5, 2  # in which an interval is divided, twice: 1250 Hz
DEEPEST = 4  # times it is divided where the clearance is not proven: 31 kHz
PROVEN = 1e-4  # m: less than the clearance by this is as good
LAST = 20  # parts, about the smallest distance found
SAFETY = 2.0  # on the speed that a pair has shown


@dataclass(frozen=True)
class Nearest:
    """The smallest distance (m), between which two, at which time (s)."""

    distance: float
    pair: tuple[str, str]
    time: float


def nearest(space: Distances, trajectory: Trajectory, clearance: float) -> Nearest | None:
    """Return the smallest distance along a trajectory, None where no pair is watched.

    Sampled at 50 Hz, and finer, up to 1250 Hz, where a pair may come below the ``clearance`` (m), or below the smallest
    distance found, there then at 25 kHz; and up to 31 kHz until no pair can come below the clearance by 0.1 mm. How
    fast it may come nearer is known where the space is ``Steep``; else it is twice the speed shown about that time.
    """
    if not space.pairs:
        return None
    t = np.linspace(0.0, trajectory.duration, max(2, int(np.ceil(trajectory.duration * COARSE)) + 1))
    h = float(t[1])
    states = trajectory.states(t)
    d = space.distances(states[0])
    best = _least(space, t, d)
    speed = _speeds(space, states, h) if isinstance(space, Steep) else _shown(d, h)
    starts, lower = t[:-1], np.minimum(d[:-1], d[1:])
    for level in range(DEEPEST):
        enough = max(clearance, best.distance) if level < LEVELS else clearance - PROVEN
        near = (lower - speed * h / 2 <= enough).any(axis=1)
        times = starts[near, None] + h * np.linspace(0.0, 1.0, PARTS + 1)
        if not times.size:
            break
        d = space.distances(trajectory.states(times.ravel())[0]).reshape(*times.shape, -1)
        best = min(best, _least(space, times.ravel(), d.reshape(times.size, -1)), key=_distance)
        h, speed = h / PARTS, np.repeat(speed[near], PARTS, axis=0)
        starts, lower = times[:, :-1].ravel(), np.minimum(d[:, :-1], d[:, 1:]).reshape(-1, d.shape[2])
    last = np.clip(best.time + h * np.linspace(-1.0, 1.0, 2 * LAST + 1), 0.0, trajectory.duration)
    return min(best, _least(space, last, space.distances(trajectory.states(last)[0])), key=_distance)


def _shown(d: Array, h: float) -> Array:
    """Return twice the speeds (K, P) that pairs have shown in and about intervals of h (s), from d (K + 1, P)."""
    speed = np.abs(np.diff(d, axis=0)) / h
    wide = np.pad(speed, ((1, 1), (0, 0)))
    return SAFETY * np.maximum(np.maximum(wide[:-2], wide[2:]), speed)


def _speeds(space: Steep, states: Array, h: float) -> Array:
    """Return the speeds (K, P) that pairs can have in intervals of h (s) between states (4, K + 1, n)."""
    dq, ddq, jerk = np.maximum(np.abs(states[1:, :-1]), np.abs(states[1:, 1:]))
    return np.asarray((dq + h / 2 * (ddq + h / 2 * jerk)) @ space.steepest.T)


def _distance(one: Nearest) -> float:
    return one.distance


def _least(space: Distances, t: Array, d: Array) -> Nearest:
    row, pair = np.unravel_index(int(d.argmin()), d.shape)
    return Nearest(float(d[row, pair]), space.pairs[pair], float(t[row]))
