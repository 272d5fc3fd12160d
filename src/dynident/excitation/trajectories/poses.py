"""Poses at rest whose torques tell of gravity: chosen one by one, by what each adds to those before."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.excitation.trajectories.feasibility import Feasibility
from dynident.excitation.trajectories.quintic import Quintic
from dynident.excitation.trajectories.sweep import Hold
from dynident.excitation.trajectories.trajectory import Piece, Purpose
from dynident.excitation.trajectories.way import way

__all__ = ["informative_poses", "static_poses"]

Array = NDArray[np.float64]
CANDIDATES = 400
HOLD = 2.0  # s in each pose
MOST = 60  # poses
VAGUE = 1e-3  # information that is taken as known before, as a share of what a mean candidate gives
RANK = 1e-8  # of the largest singular value: what is less is not shown by gravity


def informative_poses(feasible: Feasibility, weights: Array, count: int, rng: np.random.Generator) -> Array:
    """Return ``count`` poses (K, n) in the order in which they add most to log det of the information on what the
    torque at rest shows, of random poses in which the arm can stand; ``weights`` (n) are 1 / sigma^2 by joint.

    V. V. Fedorov, "Theory of optimal experiments", 1972: the gain is log det(I + Z P Z').
    """
    poses = feasible.poses(CANDIDATES, rng)
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
    return poses[chosen]


def static_poses(
    feasible: Feasibility,
    duration: float,
    start: Array | None,
    weights: Array,
    rng: np.random.Generator,
    hold: float = HOLD,
) -> tuple[Piece, ...]:
    """Return as many poses, each held for ``hold`` (s), as there is time for within ``duration`` (s), with the ways
    between them, from and to the pose ``start`` (n; None: the first of them).

    Raises ConfigError where the time does not suffice for one.
    """
    wanted = max(1, min(MOST, int(duration / hold)))
    poses = informative_poses(feasible, weights, wanted, rng)
    known: dict[tuple[int, int], tuple[Quintic, ...] | None] = {}
    home = poses[0] if start is None else start
    stops = np.concatenate([[home], poses])
    kept = list(range(1, len(stops)))
    while kept:
        pieces, kept, time = _tour(feasible, stops, kept, hold, known, rng)
        if kept and time <= duration:
            return pieces
        kept = kept[: -max(1, int(len(kept) * (1 - duration / time) / 2))] if kept else []
    raise ConfigError(
        f"the gravity program has {duration:.1f} s, too little to reach a pose, hold it for {hold:g} s and return; "
        "give it more time."
    )


def _tour(
    feasible: Feasibility,
    stops: Array,
    kept: list[int],
    hold: float,
    known: dict[tuple[int, int], tuple[Quintic, ...] | None],
    rng: np.random.Generator,
) -> tuple[tuple[Piece, ...], list[int], float]:
    """Return the pieces from stop 0 by those kept back to it, always to the nearest, without those that no way leads
    to; those kept, in their order of importance; and how long it takes (s)."""

    def between(one: int, other: int) -> tuple[Quintic, ...] | None:
        if (one, other) not in known:
            known[one, other] = way(feasible, stops[one], stops[other], rng)
        return known[one, other]

    tour, left = [0], set(kept)
    while left:
        apart = {k: float(np.abs((stops[k] - stops[tour[-1]]) / feasible.limits.velocity).max()) for k in left}
        nearest = min(left, key=apart.__getitem__)
        left.remove(nearest)
        if between(tour[-1], nearest) is not None:
            tour.append(nearest)
    while len(tour) > 1 and between(tour[-1], 0) is None:
        tour.pop()
    pieces: list[Piece] = []
    for one, other in pairwise([*tour, 0]):
        pieces += [Piece(course, Purpose.WAY) for course in between(one, other) or ()]
        if other:
            pieces.append(Piece(Hold(hold, stops[other]), Purpose.POSE, str(tour.index(other))))
    return tuple(pieces), [k for k in kept if k in tour], sum(piece.course.duration for piece in pieces)
