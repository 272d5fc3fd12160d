"""Ways of the whole arm from one pose to another: straight where that is free, else by other poses."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.trajectories.feasibility import RESERVE, Feasibility
from dynident.excitation.trajectories.quintic import Quintic, at_rest, durations

__all__ = ["direct", "way"]

Array = NDArray[np.float64]
LONGER, TRIES = 1.3, 10  # what is too much for the torque is tried slower
POSES, NEAR = (60, 240), 8  # of a detour: random poses, and how many near ones each is tried with
CHECKS = 150  # ways that are looked at closely
STOP = 0.5  # s that a pose in between costs
SAME = 1e-9  # rad or m
ROUGH, SPACING = 0.2, 0.02  # rad or m along a path


def direct(feasible: Feasibility, start: Array, end: Array) -> Quintic | None:
    """Return the shortest allowed quintic from a state to another (3, n), or None."""
    straight = not (start[1:].any() or end[1:].any())  # its path does not depend on its duration
    if straight and not _path_is_free(feasible, start[0], end[0]):
        return None
    last, tries = 0.0, 0
    for duration in durations(feasible.limits, start, end):
        if duration < LONGER * last:
            continue
        course, last, tries = Quintic(duration, start, end), duration, tries + 1
        if feasible.effort(course) <= 1 - RESERVE and (straight or feasible.clear(course)):
            return course
        if tries == TRIES:
            break
    return None


def _path_is_free(feasible: Feasibility, start: Array, end: Array) -> bool:
    """Return whether the arm is free all along the straight path between poses (n)."""
    steps = np.linspace(0.0, 1.0, 2 + int(np.abs(end - start).max() / SPACING))
    return bool(feasible.free(start + steps[:, None] * (end - start)).all())


def way(feasible: Feasibility, start: Array, end: Array, rng: np.random.Generator) -> tuple[Quintic, ...] | None:
    """Return courses from a pose at rest to another (n), by way of others where the straight way is not free; none
    where the poses are the same; None where no way is found.

    The others are found by a probabilistic roadmap whose ways are looked at closely when they are on a route: R. Bohlin
    and L. E. Kavraki, "Path planning using lazy PRM", IEEE International Conference on Robotics and Automation, 2000.
    """
    if np.abs(start - end).max() < SAME:
        return ()
    if course := direct(feasible, at_rest(start), at_rest(end)):
        return (course,)
    if not feasible.stands(np.stack([start, end])).all():
        return None
    for count in POSES:
        poses = np.concatenate([[start, end], feasible.poses(count, rng)])
        cost = _costs(feasible, poses)
        if not np.isfinite(cost[:2]).any(axis=1).all():  # nothing can be reached from one of them
            return None
        if found := _route(feasible, poses, cost):
            return found
    return None


def _costs(feasible: Feasibility, poses: Array) -> Array:
    """Return the times (K, K) in s of the ways between near poses (K, n), and between the first two and all others;
    infinite where something is in the way at one of a few points."""
    apart = (np.abs(poses[:, None] - poses) / feasible.limits.velocity).max(axis=2)
    near = apart <= np.sort(apart, axis=1)[:, [min(NEAR, len(poses) - 1)]]
    near[:2] = near[:, :2] = True
    near[0, 1] = near[1, 0] = False
    one, other = np.nonzero(np.triu(near | near.T, 1))
    counts = 2 + (np.abs(poses[one] - poses[other]).max(axis=1) / ROUGH).astype(int)
    first = np.cumsum(counts) - counts
    steps = (np.arange(counts.sum()) - np.repeat(first, counts)) / np.repeat(counts - 1, counts)
    points = np.repeat(poses[one], counts, axis=0) + steps[:, None] * np.repeat(
        poses[other] - poses[one], counts, axis=0
    )
    free = np.logical_and.reduceat(feasible.free(points), first)
    cost = np.full(apart.shape, np.inf)
    cost[one[free], other[free]] = cost[other[free], one[free]] = apart[one[free], other[free]] + STOP
    return cost


def _route(feasible: Feasibility, poses: Array, cost: Array) -> tuple[Quintic, ...] | None:
    """Return courses from the first of the poses (K, n) to the second by the cheapest ways that prove to be free."""
    from scipy.sparse.csgraph import dijkstra

    found: dict[tuple[int, int], Quintic] = {}
    for _ in range(CHECKS):
        total, before = dijkstra(cost, indices=0, return_predecessors=True)
        if not np.isfinite(total[1]):
            return None
        route = [1]
        while route[-1]:
            route.append(int(before[route[-1]]))
        edges = list(pairwise(reversed(route)))
        unknown = [edge for edge in edges if edge not in found]
        if not unknown:
            return tuple(found[edge] for edge in edges)
        one, other = unknown[0]
        if course := direct(feasible, at_rest(poses[one]), at_rest(poses[other])):
            found[one, other] = course
        else:
            cost[one, other] = cost[other, one] = np.inf
    return None
