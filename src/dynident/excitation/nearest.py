"""Where along a trajectory an arm comes closest to itself or to an obstacle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.space import Distances
from dynident.excitation.trajectory import Trajectory

__all__ = ["Nearest", "nearest"]

Array = NDArray[np.float64]
COARSE, FINE, FINEST = 50.0, 1000.0, 10000.0  # Hz
SAFETY = 2.0  # on the largest speed seen with which a pair approaches


@dataclass(frozen=True)
class Nearest:
    """The smallest distance (m), between which two, at which time (s)."""

    distance: float
    pair: tuple[str, str]
    time: float


def nearest(space: Distances, trajectory: Trajectory, clearance: float) -> Nearest | None:
    """Return the smallest distance along a trajectory, None where no pair is watched.

    Sampled at 50 Hz, at 1 kHz where a pair may come below the ``clearance`` (m) in between at twice the largest speed
    it has shown, or where it is closest, there then at 10 kHz.
    """
    if not space.pairs:
        return None
    t = np.linspace(0.0, trajectory.duration, max(2, int(np.ceil(trajectory.duration * COARSE)) + 1))
    d = space.distances(trajectory.states(t)[0])
    lower = np.minimum(d[:-1], d[1:]) - SAFETY * np.abs(np.diff(d, axis=0)).max(axis=0) / 2
    near = (lower <= max(clearance, float(d.min()))).any(axis=1)
    best = _least(space, t, d)
    for rate, width in ((FINE, None), (FINEST, 1 / FINE)):
        if width is None:
            fine = np.concatenate([_between(t[k], t[k + 1], rate) for k in np.flatnonzero(near)])
        else:
            fine = _between(max(0.0, best.time - width), min(trajectory.duration, best.time + width), rate)
        found = _least(space, fine, space.distances(trajectory.states(fine)[0]))
        best = min(best, found, key=lambda one: one.distance)
    return best


def _between(start: float, end: float, rate: float) -> Array:
    return np.linspace(start, end, max(2, int(np.ceil((end - start) * rate)) + 1))


def _least(space: Distances, t: Array, d: Array) -> Nearest:
    row, pair = np.unravel_index(int(d.argmin()), d.shape)
    return Nearest(float(d[row, pair]), space.pairs[pair], float(t[row]))
