"""Ways of the whole arm from one pose to another: straight where that is free, else by other poses."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.feasibility import RESERVE, SPARE, Feasibility
from dynident.excitation.quintic import Quintic, at_rest, durations

__all__ = ["direct", "way"]

Array = NDArray[np.float64]
LONGER, TRIES = 1.2, 16  # what is too much for the torque is tried slower
POSES, CHECKS = 120, 400  # of a detour: random poses, ways that are tried
STOP = 0.5  # s that a pose in between costs
SAME = 1e-9  # rad or m
SPACING = 0.02  # rad or m along a path


def direct(feasible: Feasibility, start: Array, end: Array) -> Quintic | None:
    """Return the shortest allowed quintic from a state to another (3, n), or None."""
    straight = not (start[1:].any() or end[1:].any())  # its path does not depend on its duration
    if straight and not _path_is_clear(feasible, start[0], end[0]):
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


def _path_is_clear(feasible: Feasibility, start: Array, end: Array) -> bool:
    """Return whether the straight path between poses (n) keeps its distance."""
    steps = np.linspace(0.0, 1.0, 2 + int(np.abs(end - start).max() / SPACING))
    return bool(feasible.gaps(start + steps[:, None] * (end - start)).min() >= SPARE)


def way(feasible: Feasibility, start: Array, end: Array, rng: np.random.Generator) -> tuple[Quintic, ...] | None:
    """Return courses from a pose at rest to another (n), by way of others where the straight way is not free; none
    where the poses are the same; None where no way is found.

    The others are found as in a lazy probabilistic roadmap: R. Bohlin and L. E. Kavraki, "Path planning using lazy
    PRM", IEEE International Conference on Robotics and Automation, 2000.
    """
    if np.abs(start - end).max() < SAME:
        return ()
    if course := direct(feasible, at_rest(start), at_rest(end)):
        return (course,)
    if not feasible.stands(np.stack([start, end])).all():
        return None
    return _detour(feasible, np.concatenate([[start, end], feasible.poses(POSES, rng)]))


def _detour(feasible: Feasibility, poses: Array) -> tuple[Quintic, ...] | None:
    """Return courses from the first of the poses (K, n) to the second, by way of the others."""
    from scipy.sparse.csgraph import dijkstra

    apart = np.abs(poses[:, None] - poses) / feasible.limits.velocity
    cost = apart.max(axis=2) + STOP  # s
    cost[0, 1] = cost[1, 0] = np.inf
    found: dict[tuple[int, int], Quintic] = {}
    for _ in range(CHECKS):
        total, before = dijkstra(cost, indices=0, return_predecessors=True)
        if not np.isfinite(total[1]):
            return None
        route = [1]
        while route[-1]:
            route.append(int(before[route[-1]]))
        edges = list(pairwise(reversed(route)))
        open_edges = [edge for edge in edges if edge not in found]
        if not open_edges:
            return tuple(found[edge] for edge in edges)
        one, other = open_edges[0]
        if course := direct(feasible, at_rest(poses[one]), at_rest(poses[other])):
            found[one, other] = course
        else:
            cost[one, other] = cost[other, one] = np.inf
    return None
