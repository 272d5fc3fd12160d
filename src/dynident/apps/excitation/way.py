"""Paths of the whole arm from one pose to another: straight where that is free, else by way of other poses."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.apps.excitation.family import Fourier, LinearCourse
from dynident.apps.excitation.limits import TORQUE_RESERVE, Feasibility, MotionLimits
from dynident.apps.excitation.trajectory import Course, Piece, Purpose, round_up
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

DEGREE = 5
BOUND_PARTS = 16  # in which a polynomial is bounded, each by its Bernstein coefficients
MIN_DURATION, MAX_DURATION, DURATION_RATIO = 0.05, 300.0, 1.05  # s, s, ratio: the durations that are tried
LIMIT_ROUNDING = 1e-9  # of a limit
MIN_RETRY_RATIO, MAX_DURATIONS = 1.3, 10  # what is too much for the torque is tried slower
DETOUR_POSES, NEIGHBOURS = (60, 240), 8  # of a detour: random poses, and how many near ones each is tried with
MAX_EDGE_CHECKS = 150  # ways that are looked at closely
STOP_COST = 0.5  # s that a pose in between costs
POSE_TOLERANCE = 1e-9  # rad or m
ROUGH_SPACING, PATH_SPACING = 0.2, 0.02  # rad or m along a path

START_PHASES = 32  # at which a series may begin
RAMP_DURATIONS = np.geomspace(0.2, 4.0, 16)  # s
MAX_RAMP_PAIRS = 6  # pairs of ramps whose ways are sought
RAMP_IN, RAMP_OUT = "in", "out"  # labels of the ramps


class Quintic(Noun):
    """Motion of a ``duration`` (s) from the state ``start`` to the state ``end``, q, dq and ddq, each (3, n)."""

    duration: float
    start: Array
    end: Array

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        s = np.asarray(t, dtype=float) / self.duration
        powers = np.stack([_power_derivatives(s, d) for d in range(4)])
        polynomial = coefficients(self.start, self.end, np.array([self.duration]))[0]
        return np.asarray(powers @ polynomial / self.duration ** np.arange(4.0)[:, None, None])


def rest_state(q: Array) -> Array:
    """Return the state (3, n) of a pose (n) at rest."""
    q = np.asarray(q, dtype=float)
    return np.stack([q, np.zeros_like(q), np.zeros_like(q)])


def coefficients(start: Array, end: Array, duration: Array) -> Array:
    """Return the polynomials (D, 6, n) in t / T for each duration T (D) in s, between states (3, n) or (D, 3, n)."""
    # polynomials in t / T have well-scaled coefficients: derivatives are multiplied by powers of T
    scale = duration[:, None, None] ** np.arange(3.0)[:, None]
    ends = np.concatenate([start * scale, end * scale], axis=1)
    end_matrix = np.concatenate([[_power_derivatives(np.array([s]), d)[0] for d in range(3)] for s in (0.0, 1.0)])
    return np.asarray(np.linalg.inv(end_matrix) @ ends)


def quintic_bounds(start: Array, end: Array, duration: Array) -> tuple[Array, Array, Array]:
    """Return bounds of the quintics of durations T (D) that hold at all times, and are nearly tight.

    The states are (3, n), or (D, 3, n) by duration. The bounds are the least and the greatest q (D, n), and
    the largest absolute dq, ddq and jerk (D, 3, n).
    """
    polynomials = coefficients(start, end, duration)
    # a polynomial lies within the hull of its Bernstein coefficients; on short parts the hull is tight
    hulls = [_bernstein_matrix(d) @ polynomials for d in range(4)]
    sizes = [np.abs(hulls[d]).max(axis=1) / duration[:, None] ** d for d in (1, 2, 3)]
    return hulls[0].min(axis=1), hulls[0].max(axis=1), np.stack(sizes, axis=1)


def feasible_durations(limits: MotionLimits, start: Array, end: Array, step: float = 0.0) -> Iterator[float]:
    """Yield the durations (s) with which a quintic from a state to another (3, n) keeps the limits, shortest first.

    These are the limits of position, velocity, acceleration and jerk. Durations from ``MIN_DURATION`` to
    ``MAX_DURATION`` are tried in steps of a twentieth, in whole multiples of ``step`` (s).
    """
    count = round(np.log(MAX_DURATION / MIN_DURATION) / np.log(DURATION_RATIO)) + 1
    candidates = np.unique(round_up(np.geomspace(MIN_DURATION, MAX_DURATION, count), step))
    yield from candidates[_keeps_limits(limits, start, end, candidates)].tolist()


def _keeps_limits(limits: MotionLimits, start: Array, end: Array, duration: Array) -> NDArray[np.bool_]:
    """Return which quintics of durations T (D) keep the limits, between states as those of ``quintic_bounds``."""
    low, high, sizes = quintic_bounds(start, end, duration)
    tolerance = LIMIT_ROUNDING * (1 + limits.half)
    is_within = ((low >= limits.lower - tolerance) & (high <= limits.upper + tolerance)).all(axis=1)
    return np.asarray(is_within & (sizes <= limits.sizes[1:] * (1 + LIMIT_ROUNDING)).all(axis=(1, 2)))


def _power_derivatives(s: Array, d: int) -> Array:
    """Return the derivatives of order ``d`` of 1, s, ... s^5, shape (N, 6)."""
    k = np.arange(DEGREE + 1)
    factor = np.prod([k - j for j in range(d)], axis=0) if d else np.ones(DEGREE + 1)
    return np.asarray(factor * s[:, None] ** np.maximum(k - d, 0))


@cache
def _bernstein_matrix(d: int) -> Array:
    """Return the Bernstein coefficients (R, 6) of the derivative of order ``d`` of 1, s, ... s^5 on the parts
    of 0 to 1."""
    from scipy.interpolate import BPoly

    size = DEGREE - d + 1
    nodes = np.linspace(0, 1, size)
    at_nodes = BPoly(np.eye(size)[:, None], [0, 1])(nodes)  # of the Bernstein polynomials
    return np.concatenate(
        [np.linalg.solve(at_nodes, _power_derivatives((k + nodes) / BOUND_PARTS, d)) for k in range(BOUND_PARTS)]
    )


def direct_path(feasible: Feasibility, start: Array, end: Array) -> Quintic | None:
    """Return the shortest allowed quintic from a state to another (3, n), or None."""
    is_straight = not (start[1:].any() or end[1:].any())  # its path does not depend on its duration
    if is_straight and not _path_is_free(feasible, start[0], end[0]):
        return None
    last_duration, count = 0.0, 0
    for duration in feasible_durations(feasible.limits, start, end, feasible.step):
        # a slightly longer duration hardly lowers the torque: skip to one that does
        if duration < MIN_RETRY_RATIO * last_duration:
            continue
        course, last_duration, count = Quintic(duration, start, end), duration, count + 1
        if feasible.max_torque_share(course) <= 1 - TORQUE_RESERVE and (is_straight or feasible.is_clear(course)):
            return course
        if count == MAX_DURATIONS:
            break
    return None


def _path_is_free(feasible: Feasibility, start: Array, end: Array) -> bool:
    """Return whether the arm is free all along the straight path between poses (n)."""
    steps = np.linspace(0.0, 1.0, 2 + int(np.abs(end - start).max() / PATH_SPACING))
    return bool(feasible.is_free(start + steps[:, None] * (end - start)).all())


def find_path(feasible: Feasibility, start: Array, end: Array, rng: np.random.Generator) -> tuple[Piece, ...] | None:
    """Return pieces from a pose at rest to another (n), by way of other poses where the straight path is not free.

    There are none where the poses are the same. None where no path is found. The other poses come from a
    probabilistic roadmap whose edges are checked in full only when they are on a route: R. Bohlin and L. E.
    Kavraki, "Path planning using lazy PRM", IEEE International Conference on Robotics and Automation, 2000.
    """
    if np.abs(start - end).max() < POSE_TOLERANCE:
        return ()
    if course := direct_path(feasible, rest_state(start), rest_state(end)):
        return (Piece(course, Purpose.WAY),)
    if not feasible.can_stand(np.stack([start, end])).all():
        return None
    for count in DETOUR_POSES:
        poses = np.concatenate([[start, end], feasible.random_poses(count, rng)])
        cost = _travel_costs(feasible, poses)
        if not np.isfinite(cost[:2]).any(axis=1).all():  # nothing can be reached from one of them
            return None
        if path := _cheapest_path(feasible, poses, cost):
            return path
    return None


def _travel_costs(feasible: Feasibility, poses: Array) -> Array:
    """Return the travel times (K, K) in s between near poses (K, n), and between the first two and all others.

    They are infinite where something is in the way at one of a few points.
    """
    travel_times = (np.abs(poses[:, None] - poses) / feasible.limits.velocity).max(axis=2)
    # each pose is tried with its nearest ones, start and end with all, but not with each other: that has failed
    is_near = travel_times <= np.sort(travel_times, axis=1)[:, [min(NEIGHBOURS, len(poses) - 1)]]
    is_near[:2] = is_near[:, :2] = True
    is_near[0, 1] = is_near[1, 0] = False
    origins, targets = np.nonzero(np.triu(is_near | is_near.T, 1))
    counts = 2 + (np.abs(poses[origins] - poses[targets]).max(axis=1) / ROUGH_SPACING).astype(int)
    first_rows = np.cumsum(counts) - counts
    # points of all edges one below the other, so that the arm is checked in one call
    fractions = (np.arange(counts.sum()) - np.repeat(first_rows, counts)) / np.repeat(counts - 1, counts)
    points = np.repeat(poses[origins], counts, axis=0) + fractions[:, None] * np.repeat(
        poses[targets] - poses[origins], counts, axis=0
    )
    free = np.logical_and.reduceat(feasible.is_free(points), first_rows)
    cost = np.full(travel_times.shape, np.inf)
    cost[origins[free], targets[free]] = cost[targets[free], origins[free]] = (
        travel_times[origins[free], targets[free]] + STOP_COST
    )
    return cost


def _cheapest_path(feasible: Feasibility, poses: Array, cost: Array) -> tuple[Piece, ...] | None:
    """Return pieces from the first of the poses (K, n) to the second along the cheapest edges that are free."""
    from scipy.sparse.csgraph import dijkstra

    courses: dict[tuple[int, int], Quintic] = {}
    for _ in range(MAX_EDGE_CHECKS):
        # lazy: edges are checked in full only once they lie on the cheapest route
        costs, predecessors = dijkstra(cost, indices=0, return_predecessors=True)
        if not np.isfinite(costs[1]):
            return None
        route = [1]
        while route[-1]:
            route.append(int(predecessors[route[-1]]))
        edges = list(pairwise(reversed(route)))
        unchecked = [edge for edge in edges if edge not in courses]
        if not unchecked:
            return tuple(Piece(courses[edge], Purpose.WAY) for edge in edges)
        origin, target = unchecked[0]
        if course := direct_path(feasible, rest_state(poses[origin]), rest_state(poses[target])):
            courses[origin, target] = course
        else:
            # the edge is not free: remove it and search again
            cost[origin, target] = cost[target, origin] = np.inf
    return None


def from_rest(
    feasible: Feasibility, course: LinearCourse, periods: int, start: Array | None, rng: np.random.Generator
) -> tuple[Piece, ...] | None:
    """Return ``periods`` of a motion, given once through, between paths from and to the pose ``start`` (n).

    A series begins at the phase with the shortest ramps. Where ``start`` is None the motion begins and ends in the pose
    in which its own ramp begins. None where no ramp or no path is allowed. The motion itself is not checked.
    """
    family, x = course.family, course.x
    if not isinstance(family, Fourier):
        return _with_paths(feasible, _periods(course, periods), (x[:, 0], x[:, 0]), start, rng)
    for (enter, leave), shifted_x in islice(_allowed_ramps(feasible, family, x), MAX_RAMP_PAIRS):
        motion = (
            Piece(enter, Purpose.WAY, RAMP_IN),
            *_periods(LinearCourse(family, shifted_x), periods),
            Piece(leave, Purpose.WAY, RAMP_OUT),
        )
        if pieces := _with_paths(feasible, motion, (enter.start[0], leave.end[0]), start, rng):
            return pieces
    return None


def _periods(course: Course, count: int) -> tuple[Piece, ...]:
    return tuple(Piece(course, Purpose.MOTION, str(k + 1)) for k in range(count))


def _with_paths(
    feasible: Feasibility,
    motion: tuple[Piece, ...],
    ends: tuple[Array, Array],
    start: Array | None,
    rng: np.random.Generator,
) -> tuple[Piece, ...] | None:
    """Return a motion between poses at rest with the paths to it and back; None where there is no path."""
    home = ends[0] if start is None else start
    path_there, path_back = find_path(feasible, home, ends[0], rng), find_path(feasible, ends[1], home, rng)
    if path_there is None or path_back is None:
        return None
    return (*path_there, *motion, *path_back)


def _allowed_ramps(feasible: Feasibility, family: Fourier, x: Array) -> Iterator[tuple[tuple[Quintic, Quintic], Array]]:
    """Yield the allowed pairs of ramps in and out, the shortest first.

    With them come the coefficients of the series that begins between them.
    """
    phases = np.arange(START_PHASES) * family.period / START_PHASES
    states = LinearCourse(family, x).states(phases)[:3].transpose(1, 0, 2)  # (PHASES, 3, n)
    enter, leave = _shortest_ramps(feasible, states, backward=False), _shortest_ramps(feasible, states, backward=True)
    # a phase counts if both of its ramps keep the limits; the shortest pair comes first
    for _, k in sorted((enter[k][0] + leave[k][0], k) for k in enter.keys() & leave.keys()):
        pair = enter[k][1], leave[k][1]
        if all(map(feasible.allows, pair)):
            yield pair, family.shift(x, float(phases[k]))


def _shortest_ramps(feasible: Feasibility, states: Array, *, backward: bool) -> dict[int, tuple[float, Quintic]]:
    """Return by phase index the shortest ramp that keeps the limits, with its duration in s.

    The pose at rest is where the velocity, a polynomial of degree 3 in time, takes the arm in the ramp.
    """
    sign = 1.0 if backward else -1.0
    durations = np.unique(round_up(RAMP_DURATIONS, feasible.step))
    ramps = np.tile(durations, len(states))
    motion_states = np.repeat(states, len(durations), axis=0)  # (P R, 3, n)
    T = ramps[:, None]
    rest_states = np.zeros_like(motion_states)
    # integral of the cubic velocity that fits velocity and acceleration at one end, and rest at the other
    rest_states[:, 0] = motion_states[:, 0] + sign * motion_states[:, 1] * T / 2 + motion_states[:, 2] * T**2 / 12
    start, end = (motion_states, rest_states) if backward else (rest_states, motion_states)
    shortest: dict[int, tuple[float, Quintic]] = {}
    for row in np.flatnonzero(_keeps_limits(feasible.limits, start, end, ramps))[::-1]:  # the shortest last
        duration = float(ramps[row])
        shortest[int(row) // len(durations)] = duration, Quintic(duration, start[row], end[row])
    return shortest
