"""Polynomials of degree 5 between two states: ways whose duration follows from the limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.excitation.trajectories.limits import MotionLimits

__all__ = ["Quintic", "at_rest", "durations", "quintic_reach"]

Array = NDArray[np.float64]
DEGREE = 5
PARTS = 16  # in which a polynomial is bounded, each by its Bernstein coefficients
SHORTEST, LONGEST, STEP = 0.05, 300.0, 1.05  # s, s, ratio: the durations that are tried
ROUNDING = 1e-9  # of a limit


@dataclass(frozen=True, eq=False)
class Quintic:
    """The motion of a ``duration`` (s) from the state ``start`` to the state ``end``, q, dq and ddq, each (3, n)."""

    duration: float
    start: Array
    end: Array

    __repr__ = brief

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        s = np.asarray(t, dtype=float) / self.duration
        powers = np.stack([_powers(s, d) for d in range(4)])
        return np.asarray(powers @ self._coefficients / self.duration ** np.arange(4.0)[:, None, None])

    @cached_property
    def _coefficients(self) -> Array:
        return np.asarray(coefficients(self.start, self.end, np.array([self.duration]))[0])


def at_rest(q: Array) -> Array:
    """Return the state (3, n) of a pose (n)."""
    q = np.asarray(q, dtype=float)
    return np.stack([q, np.zeros_like(q), np.zeros_like(q)])


def coefficients(start: Array, end: Array, duration: Array) -> Array:
    """Return the polynomials (D, 6, n) in t / T for each duration T (D) in s, between states (3, n) or (D, 3, n)."""
    scale = duration[:, None, None] ** np.arange(3.0)[:, None]
    ends = np.concatenate([start * scale, end * scale], axis=1)
    known = np.concatenate([[_powers(np.array([s]), d)[0] for d in range(3)] for s in (0.0, 1.0)])
    return np.asarray(np.linalg.inv(known) @ ends)


def quintic_reach(start: Array, end: Array, duration: Array) -> tuple[Array, Array, Array]:
    """Return bounds of the quintics of durations T (D) that hold at all times, and exceed what they bound by little.

    The states are (3, n), or (D, 3, n) by duration. The bounds are the least and the greatest q (D, n), and the sizes
    of dq, ddq and jerk (D, 3, n).
    """
    polynomials = coefficients(start, end, duration)
    hulls = [_hull(d) @ polynomials for d in range(4)]
    sizes = [np.abs(hulls[d]).max(axis=1) / duration[:, None] ** d for d in (1, 2, 3)]
    return hulls[0].min(axis=1), hulls[0].max(axis=1), np.stack(sizes, axis=1)


def durations(limits: MotionLimits, start: Array, end: Array) -> Iterator[float]:
    """Yield the durations (s) within ``SHORTEST`` and ``LONGEST`` with which a quintic from a state to another (3, n)
    keeps the limits of position, velocity, acceleration and jerk, in steps of a twentieth, the shortest first."""
    tried = np.geomspace(SHORTEST, LONGEST, round(np.log(LONGEST / SHORTEST) / np.log(STEP)) + 1)
    low, high, sizes = quintic_reach(start, end, tried)
    spare = ROUNDING * (1 + limits.half)
    kept = ((low >= limits.lower - spare) & (high <= limits.upper + spare)).all(axis=1)
    kept &= (sizes <= limits.sizes[1:] * (1 + ROUNDING)).all(axis=(1, 2))
    yield from tried[kept].tolist()


def _powers(s: Array, d: int) -> Array:
    """Return the derivatives ``d`` of 1, s, ... s^5, shape (N, 6)."""
    k = np.arange(DEGREE + 1)
    factor = np.prod([k - j for j in range(d)], axis=0) if d else np.ones(DEGREE + 1)
    return np.asarray(factor * s[:, None] ** np.maximum(k - d, 0))


@cache
def _hull(d: int) -> Array:
    """Return the Bernstein coefficients (R, 6) of the derivative ``d`` of 1, s, ... s^5 on the parts of 0 to 1."""
    degree = DEGREE - d
    nodes = np.linspace(0, 1, degree + 1)
    at_nodes = _bernstein(nodes, degree)
    return np.concatenate([np.linalg.solve(at_nodes, _powers((k + nodes) / PARTS, d)) for k in range(PARTS)])


def _bernstein(s: Array, degree: int) -> Array:
    """Return the Bernstein polynomials of a degree, shape (N, degree + 1)."""
    from scipy.special import comb

    k = np.arange(degree + 1)
    return np.asarray(comb(degree, k) * s[:, None] ** k * (1 - s[:, None]) ** (degree - k))
