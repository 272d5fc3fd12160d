"""Periods of a motion from rest to rest: a way there, a ramp in, N periods, a ramp out, and a way back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.trajectories.family import Family
from dynident.excitation.trajectories.feasibility import Feasibility
from dynident.excitation.trajectories.fourier import Fourier
from dynident.excitation.trajectories.quintic import Quintic, quintic_reach
from dynident.excitation.trajectories.trajectory import Course, Piece, Purpose
from dynident.excitation.trajectories.way import way

__all__ = ["IN", "OUT", "from_rest"]

Array = NDArray[np.float64]
PHASES = 32  # at which a series may begin
RAMPS = np.geomspace(0.2, 4.0, 16)  # s
TRIES = 6  # pairs of ramps whose ways are sought
IN, OUT = "in", "out"  # labels of the ramps


def from_rest(
    feasible: Feasibility, family: Family, x: Array, periods: int, start: Array | None, rng: np.random.Generator
) -> tuple[Piece, ...] | None:
    """Return ``periods`` of the motion with coefficients x (n, K) between ways from and to the pose ``start`` (n).

    A series begins at the phase that takes the shortest ramps. Where ``start`` is None the motion begins and ends in
    the pose that its own ramp begins in. None where no ramp or no way is allowed. The motion itself is not looked at.
    """
    if not isinstance(family, Fourier):
        return _joined(feasible, (), family.course(x), periods, (), (x[:, 0], x[:, 0]), start, rng)
    for (enter, leave), shifted in islice(_ramps(feasible, family, x), TRIES):
        ends = enter.start[0], leave.end[0]
        if found := _joined(feasible, (enter,), family.course(shifted), periods, (leave,), ends, start, rng):
            return found
    return None


def _joined(
    feasible: Feasibility,
    enter: Sequence[Course],
    course: Course,
    periods: int,
    leave: Sequence[Course],
    ends: tuple[Array, Array],
    start: Array | None,
    rng: np.random.Generator,
) -> tuple[Piece, ...] | None:
    """Return ways, ramps and periods in their order."""
    home = ends[0] if start is None else start
    there, back = way(feasible, home, ends[0], rng), way(feasible, ends[1], home, rng)
    if there is None or back is None:
        return None
    return (
        *(Piece(one, Purpose.WAY) for one in there),
        *(Piece(one, Purpose.WAY, IN) for one in enter),
        *(Piece(course, Purpose.MOTION, str(k + 1)) for k in range(periods)),
        *(Piece(one, Purpose.WAY, OUT) for one in leave),
        *(Piece(one, Purpose.WAY) for one in back),
    )


def _ramps(feasible: Feasibility, family: Fourier, x: Array) -> Iterator[tuple[tuple[Quintic, Quintic], Array]]:
    """Yield ramps in and out that are allowed, with the coefficients of the series that begins between them; the
    shortest first."""
    phases = np.arange(PHASES) * family.period / PHASES
    states = family.course(x).states(phases)[:3].transpose(1, 0, 2)  # (PHASES, 3, n)
    enter, leave = _allowed(feasible, states, backward=False), _allowed(feasible, states, backward=True)
    together = [(enter[k][0] + leave[k][0], k) for k in enter.keys() & leave.keys()]
    for _, k in sorted(together):
        pair = enter[k][1], leave[k][1]
        if all(map(feasible.allows, pair)):
            yield pair, family.shifted(x, float(phases[k]))


def _allowed(feasible: Feasibility, states: Array, *, backward: bool) -> dict[int, tuple[float, Quintic]]:
    """Return for each phase, by its place, the shortest ramp that keeps the limits, and its duration in s.

    The pose at rest is where the velocity, a polynomial of degree 3 in time, takes the arm in the ramp.
    """
    limits = feasible.limits
    sign = 1.0 if backward else -1.0
    ramps = np.tile(RAMPS, len(states))
    moving = np.repeat(states, len(RAMPS), axis=0)  # (P R, 3, n)
    T = ramps[:, None]
    still = np.zeros_like(moving)
    still[:, 0] = moving[:, 0] + sign * moving[:, 1] * T / 2 + moving[:, 2] * T**2 / 12
    start, end = (moving, still) if backward else (still, moving)
    low, high, sizes = quintic_reach(start, end, ramps)
    kept = ((low >= limits.lower) & (high <= limits.upper)).all(axis=1)
    kept &= (sizes <= limits.sizes[1:]).all(axis=(1, 2))
    found: dict[int, tuple[float, Quintic]] = {}
    for row in np.flatnonzero(kept)[::-1]:  # the shortest last
        duration = float(ramps[row])
        found[int(row) // len(RAMPS)] = duration, Quintic(duration, start[row], end[row])
    return found
