"""Poses whose torques tell of gravity: chosen one by one, by what each adds to those before.

The arm is held in a pose. Where joints have dry friction, that holds them with any torque up to its own: these joints
pass through the pose slowly, to and fro over the same way, so that friction has both signs and cancels.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.excitation.trajectories.dry_friction import slowest
from dynident.excitation.trajectories.feasibility import Feasibility
from dynident.excitation.trajectories.quintic import Quintic
from dynident.excitation.trajectories.sweep import Hold, Sweep, run_up
from dynident.excitation.trajectories.trajectory import Course, Piece, Purpose
from dynident.excitation.trajectories.way import way

__all__ = ["gravity_program", "informative_poses"]

Array = NDArray[np.float64]
CANDIDATES = 400
HOLD = 2.0  # s in each pose, or to and fro
MOST = 60  # poses
VAGUE = 1e-3  # information that is taken as known before, as a share of what a mean candidate gives
RANK = 1e-8  # of the largest singular value: what is less is not shown by gravity
PACE = 2.0  # times what a fit leaves out as too slow
RAMP = 0.1  # s that the jerk acts on the way to that speed and back, twice each: gently


def informative_poses(feasible: Feasibility, poses: Array, weights: Array, count: int) -> list[int]:
    """Return which ``count`` of the poses (K, n), in the order in which they add most to log det of the information on
    what the torque at rest shows; ``weights`` (n) are 1 / sigma^2 by joint.

    To and fro along one way the torque is as far above that at rest as below, so that it shows the same of gravity.
    V. V. Fedorov, "Theory of optimal experiments", 1972: the gain is log det(I + Z P Z').
    """
    still = np.zeros_like(poses)
    rows = feasible.model.regressor(poses, still, still) * np.sqrt(weights)[:, None]
    _, sizes, basis = np.linalg.svd(rows.reshape(-1, rows.shape[2]) / np.sqrt(len(poses)), full_matrices=False)
    shown = sizes > RANK * sizes[0]
    Z = rows @ (basis[shown] / sizes[shown, None]).T  # (M, n, r), of mean information I
    chosen: list[int] = []
    P = np.eye(Z.shape[2]) / VAGUE
    for _ in range(min(count, len(poses))):
        gains = np.linalg.slogdet(np.eye(Z.shape[1]) + Z @ P @ Z.transpose(0, 2, 1))[1]
        gains[chosen] = -np.inf
        chosen.append(int(gains.argmax()))
        one = Z[chosen[-1]]
        P = P - P @ one.T @ np.linalg.solve(np.eye(len(one)) + one @ P @ one.T, one @ P)
    return chosen


def gravity_program(
    feasible: Feasibility,
    duration: float,
    start: Array | None,
    weights: Array,
    rng: np.random.Generator,
    hold: float = HOLD,
) -> tuple[Piece, ...]:
    """Return as many poses, each for ``hold`` (s), as there is time for within ``duration`` (s), with the ways between
    them, from and to the pose ``start`` (n; None: the first of them).

    Raises ConfigError where the time does not suffice for one.
    """
    wanted = max(1, min(MOST, int(duration / hold)))
    visits = _visits(feasible, weights, wanted, hold, rng)
    tour = _Tour(feasible, visits, visits[0][0].pose if start is None else start, rng)
    kept = list(range(1, len(visits) + 1))
    while kept:
        pieces, kept = tour.pieces(kept)
        time = sum(piece.course.duration for piece in pieces)
        if kept and time <= duration:
            return pieces
        kept = kept[: -max(1, int(len(kept) * (1 - duration / time) / 2))] if kept else []
    raise ConfigError(
        f"the gravity program has {duration:.1f} s, too little to reach a pose, stay for {hold:g} s and return; "
        "give it more time."
    )


Visit = tuple[Hold] | tuple[Sweep, Sweep]  # what the arm does in a pose, from a place at rest back to it


def _visits(
    feasible: Feasibility, weights: Array, count: int, hold: float, rng: np.random.Generator
) -> tuple[Visit, ...]:
    """Return at most ``count`` visits of poses that may be driven, the most informative first."""
    poses = feasible.poses(CANDIDATES, rng)
    velocity = PACE * slowest(feasible.model, feasible.limits) * rng.choice((-1.0, 1.0), poses.shape)
    if not velocity.any():
        return tuple((Hold(hold, poses[k]),) for k in informative_poses(feasible, poses, weights, count))
    passes = [_to_and_fro(feasible, *one, hold) for one in zip(poses, velocity, strict=True)]
    ends = np.array([(there.pose, there.end) for there, _ in passes])
    free = np.flatnonzero(feasible.stands(ends[:, 0]) & feasible.stands(ends[:, 1]))
    driven = [k for k in free if all(map(feasible.allows, passes[k]))]
    if not driven:
        raise ConfigError(
            f"in none of {len(poses)} poses can all joints with dry friction move slowly to and fro; check the limits, "
            "and what is in the way."
        )
    return tuple(passes[driven[k]] for k in informative_poses(feasible, poses[driven], weights, count))


def _to_and_fro(feasible: Feasibility, pose: Array, velocity: Array, hold: float) -> tuple[Sweep, Sweep]:
    """Return ways through a pose (n) and back at a constant velocity (n), which take ``hold`` (s) or longer."""
    moving = np.abs(velocity)
    with np.errstate(divide="ignore"):
        most = (feasible.limits.sizes[2:] / moving).min(axis=1)
    acceleration, jerk = min(1 / RAMP, float(most[0])), min(1 / RAMP**2, float(most[1]))
    ramp, full = run_up(1.0, acceleration, jerk)
    up = 2 * ramp + full
    distance = max(hold / 2 - up, 2 * up)
    there = Sweep(pose - distance / 2 * velocity, velocity, distance, 1.0, acceleration, jerk)
    return there, Sweep(there.end, velocity, -distance, 1.0, acceleration, jerk)


@dataclass(frozen=True, eq=False)
class _Tour:
    """Visits, which begin and end at their stops, and a home (n) before and after them; stop 0 is the home."""

    feasible: Feasibility
    visits: tuple[Visit, ...]
    home: Array
    rng: np.random.Generator
    known: dict[tuple[int, int], tuple[Quintic, ...] | None] = field(default_factory=dict)

    def pieces(self, kept: list[int]) -> tuple[tuple[Piece, ...], list[int]]:
        """Return the pieces from home by the stops kept back to it, always to the nearest, without those that no way
        leads to; and those kept, in their order of importance."""
        tour, left = [0], set(kept)
        while left:
            nearest = min(left, key=lambda k: self._apart(tour[-1], k))
            left.remove(nearest)
            if self._way(tour[-1], nearest) is not None:
                tour.append(nearest)
        while len(tour) > 1 and self._way(tour[-1], 0) is None:
            tour.pop()
        pieces: list[Piece] = []
        for one, other in pairwise([*tour, 0]):
            pieces += [Piece(course, Purpose.WAY) for course in self._way(one, other) or ()]
            visit: tuple[Course, ...] = self.visits[other - 1] if other else ()
            pieces += [Piece(course, Purpose.POSE, str(tour.index(other))) for course in visit]
        return tuple(pieces), [k for k in kept if k in tour]

    def _stop(self, k: int) -> Array:
        return self.visits[k - 1][0].pose if k else self.home

    def _apart(self, one: int, other: int) -> float:
        return float(np.abs((self._stop(other) - self._stop(one)) / self.feasible.limits.velocity).max())

    def _way(self, one: int, other: int) -> tuple[Quintic, ...] | None:
        if (one, other) not in self.known:
            self.known[one, other] = way(self.feasible, self._stop(one), self._stop(other), self.rng)
        return self.known[one, other]
