"""The smallest capsule around balls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Balls", "Fitted", "fitted", "quick"]

Array = NDArray[np.float64]
DIRECTIONS = 200  # in which the outermost balls are taken while the axis is sought
HOPEFUL = 1.3  # times the volume by the best principal axis: others are tried too
STEPS = 250  # of the search, from each start
FINE = 1e-4  # of the size: where the search ends


@dataclass(frozen=True, eq=False)
class Balls:
    """Balls about ``centres`` (M, 3) with ``radii`` (M), m; points are balls without a radius."""

    centres: Array
    radii: Array

    __repr__ = brief

    @classmethod
    def joined(cls, *parts: Balls) -> Balls:
        """Return the balls of all parts."""
        return cls(np.concatenate([one.centres for one in parts]), np.concatenate([one.radii for one in parts]))

    def outermost(self) -> Balls:
        """Return those that are farthest in one of many directions."""
        if len(self.radii) <= DIRECTIONS:
            return self
        k = np.arange(DIRECTIONS) + 0.5
        turn, height = np.pi * (1 + 5**0.5) * k, 1 - 2 * k / DIRECTIONS  # a Fibonacci lattice
        around = np.sqrt(1 - height**2)
        toward = np.stack((around * np.cos(turn), around * np.sin(turn), height))
        chosen = np.unique((self.centres @ toward + self.radii[:, None]).argmax(axis=0))
        return Balls(self.centres[chosen], self.radii[chosen])


@dataclass(frozen=True, eq=False)
class Fitted:
    """A capsule: all points within ``radius`` (m) of the segment from ``start`` to ``end`` (3)."""

    start: Array
    end: Array
    radius: float

    __repr__ = brief

    @property
    def volume(self) -> float:
        """Its volume (m^3)."""
        return float(np.pi * self.radius**2 * (np.linalg.norm(self.end - self.start) + 4 / 3 * self.radius))


def fitted(balls: Balls) -> Fitted:
    """Return a capsule of about the smallest volume that contains all balls.

    For a given line as axis, and a radius, its ends follow; the line and the radius are sought from those principal
    axes that are nearly as good as the best of them, by the method of Nelder and Mead.
    """
    few = balls.outermost()
    axes, middle, size = _principal(few)
    if len(few.radii) < 3 or size == 0:
        return _around(balls, middle, axes[0], 0.0)
    volumes = [_around(few, middle, axis, 0.0).volume for axis in axes]
    starts = [np.roll(axes, -k, axis=0) for k in range(3) if volumes[k] <= HOPEFUL * min(volumes)]
    best = min((_searched(few, start, middle, size) for start in starts), key=lambda one: one[0])
    return _around(balls, *best[1:])


def quick(balls: Balls) -> Fitted:
    """Return the smallest of three capsules along the principal axes."""
    axes, middle, _ = _principal(balls)
    return min((_around(balls, middle, axis, 0.0) for axis in axes), key=lambda one: one.volume)


def _principal(balls: Balls) -> tuple[Array, Array, float]:
    """Return the principal axes (3, 3), the middle of the range along these (3), and the largest range."""
    axes = np.linalg.eigh(np.cov(balls.centres.T, bias=True))[1].T[::-1]
    along = balls.centres @ axes.T
    low, high = (along - balls.radii[:, None]).min(axis=0), (along + balls.radii[:, None]).max(axis=0)
    return axes, (low + high) / 2 @ axes, float((high - low).max())


def _searched(balls: Balls, axes: Array, middle: Array, size: float) -> tuple[float, Array, Array, float]:
    """Return the least volume found from the first axis, with a point and direction of the line, and a wider radius."""
    from scipy.optimize import minimize

    def line(x: Array) -> tuple[Array, Array, float]:
        """Return point, direction and extra radius: two shifts, two tilts, and a root."""
        along = axes[0] + x[2] * axes[1] + x[3] * axes[2]
        shift = size * (x[0] * axes[1] + x[1] * axes[2])
        return middle + shift, along / np.linalg.norm(along), size * float(x[4]) ** 2

    start = np.vstack((np.zeros(5), 0.1 * np.eye(5)))
    options = {"maxfev": STEPS, "initial_simplex": start, "fatol": FINE, "xatol": FINE}
    found = minimize(
        lambda x: _around(balls, *line(x)).volume / size**3, start[0], method="Nelder-Mead", options=options
    )
    return float(found.fun), *line(found.x)


def _around(balls: Balls, point: Array, along: Array, extra: float) -> Fitted:
    """Return the shortest capsule about a line that contains all balls, ``extra`` wider than needed (m)."""
    away = balls.centres - point
    t = away @ along
    across = np.sqrt(np.maximum(np.einsum("ki,ki->k", away, away) - t * t, 0.0))
    radius = float((across + balls.radii).max()) + extra
    reach = np.sqrt(np.maximum((radius - balls.radii) ** 2 - across**2, 0.0))
    first, last = float((t + reach).min()), float((t - reach).max())
    if first > last:  # a ball is enough
        first = last = (first + last) / 2
    return Fitted(point + first * along, point + last * along, radius)
