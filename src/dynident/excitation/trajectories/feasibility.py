"""Whether a course may be driven, by samples of it: torque and clearance. ``verify`` checks the finished motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, brief
from dynident.excitation.spaces.space import Distances
from dynident.excitation.trajectories.limits import MotionLimits
from dynident.excitation.trajectories.trajectory import Course

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["Feasibility"]

Array = NDArray[np.float64]
RATE, FEWEST = 100.0, 25  # Hz, samples of a course
RESERVE = 0.02  # of a torque limit, for what lies between samples
SPARE = 1e-3  # m of distance, likewise
CREEP = 0.01  # of the velocity limit: slow
BATCH, BATCHES = 500, 10  # random poses


@dataclass(frozen=True, eq=False)
class Feasibility:
    """What a model with parameters ``theta`` (p) may do: within ``limits``, ``clearance`` (m) away from all in
    ``space`` (None: nothing is in the way)."""

    model: Model
    theta: Array
    limits: MotionLimits
    space: Distances | None = None
    clearance: float = 0.0

    __repr__ = brief

    def effort(self, course: Course) -> float:
        """Return the largest torque of a course as a share of its limit."""
        q, dq, ddq, _ = course.states(_times(course))
        return float(self.shares(q, dq, ddq).max(initial=0.0))

    def shares(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the sizes of the torque as shares of the limits, shape (N, n)."""
        shares: Array = np.abs(self.model.torque(q, dq, ddq, self.theta)) / self.limits.torque
        return shares

    def gaps(self, q: Array) -> Array:
        """Return the smallest distances (N), m, less the clearance, at positions q (N, n)."""
        if self.space is None:
            return np.full(len(q), np.inf)
        nearest: Array = self.space.distances(q).min(axis=1, initial=np.inf)
        return nearest - self.clearance

    def clear(self, course: Course) -> bool:
        """Return whether a course keeps its distance."""
        return bool(self.gaps(course.states(_times(course))[0]).min() >= SPARE)

    def allows(self, course: Course) -> bool:
        """Return whether a course keeps torque and distance; its position and derivatives are not looked at."""
        return self.effort(course) <= 1 - RESERVE and self.clear(course)

    def free(self, q: Array) -> NDArray[np.bool_]:
        """Return in which poses (N, n) the arm is clear, and held and moved slowly by its torque, shape (N)."""
        return np.asarray((self._slow(q) <= 1 - RESERVE).all(axis=1) & (self.gaps(q) >= SPARE))

    def stands(self, q: Array) -> NDArray[np.bool_]:
        """Return in which poses (N, n) the arm can stand: within its range and free, shape (N)."""
        inside = ((q >= self.limits.lower) & (q <= self.limits.upper)).all(axis=1)
        return np.asarray(inside & self.free(q))

    def _slow(self, q: Array) -> Array:
        """Return the shares (N, n) of the torque that poses take, whichever way the joints creep."""
        still, creep = np.zeros_like(q), np.broadcast_to(CREEP * self.limits.velocity, q.shape)
        return np.maximum(self.shares(q, creep, still), self.shares(q, -creep, still))

    def poses(self, count: int, rng: np.random.Generator) -> Array:
        """Return at most ``count`` random poses (K, n) in which the arm can stand.

        Raises ConfigError where none is found, with what is in the way.
        """
        found: list[Array] = []
        tried: list[Array] = []
        for _ in range(BATCHES):
            drawn = rng.uniform(self.limits.lower, self.limits.upper, (BATCH, len(self.limits.joints)))
            tried.append(drawn)
            found.append(drawn[self.stands(drawn)])
            if sum(map(len, found)) >= count:
                break
        poses = np.concatenate(found)[:count]
        if not len(poses):
            raise ConfigError(self._blocked(np.concatenate(tried)))
        return poses

    def _blocked(self, q: Array) -> str:
        """Return why the arm stands in none of the poses (N, n)."""
        shares = self._slow(q)
        joint = int(np.argmax((shares > 1 - RESERVE).sum(axis=0)))
        heavy, near = int((shares > 1 - RESERVE).any(axis=1).sum()), self.gaps(q) < SPARE
        parts = [f"of {len(q)} random poses the arm can stand in none."]
        if heavy:
            name, limit = self.limits.joints[joint], self.limits.torque[joint]
            parts.append(
                f"In {heavy} gravity needs more torque than is allowed, mostly of joint {name!r} ({limit:.4g})."
            )
        if self.space is not None and near.any():
            pairs = self.space.pairs
            one, other = pairs[int(np.bincount(self.space.distances(q[near]).argmin(axis=1)).argmax())]
            parts.append(
                f"In {int(near.sum())} something is nearer than {1000 * self.clearance:.3g} mm, mostly {one!r} and "
                f"{other!r}."
            )
        return " ".join([*parts, "Check the limits, the margin, and what is in the way."])


def _times(course: Course) -> Array:
    return np.linspace(0.0, course.duration, max(FEWEST, int(course.duration * RATE) + 1))
