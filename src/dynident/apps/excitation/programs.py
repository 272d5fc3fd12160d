"""The programs beside the optimised motion: joints at constant speeds for friction, and poses for gravity.

For friction each joint moves by itself, to and fro, at several speeds. The poses for gravity are chosen one by
one by what each adds to those before. The arm is held in a pose. Dry friction may hold a joint with any torque up
to its own: joints that have it pass through the pose slowly, to and fro over the same way, so that friction has both
signs and cancels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field, replace
from itertools import pairwise

import numpy as np

from dynident.apps.excitation.limits import Feasibility, min_fit_speeds
from dynident.apps.excitation.motion import MotionRequest
from dynident.apps.excitation.trajectory import Course, Hold, Piece, Purpose, Ramp, Sweep, round_up
from dynident.apps.excitation.way import find_path
from dynident.runtime import ConfigError, Noun, join_names
from dynident.runtime.arrays import Array

POSE_TRIALS, JOINT_POSITIONS = 24, 33  # poses that are tried, and positions of each joint there
MIN_SPEED_RATIO = 0.05  # of the greatest speed
MIN_SPEED_FACTOR = 1.5  # times what a fit leaves out as too slow, at least
MIN_STEADY_SHARE = 0.4  # of its way that a joint is at its constant speed at least
MIN_STEADY_TIME = 0.1  # s at a constant speed: less shows nothing
# of acceleration and jerk, and of the speed, where the torque does not suffice
ACCELERATION_FACTOR, SPEED_FACTOR = 0.5, 0.9
MAX_TRIES = 6
SEARCH_STEPS = 40  # steps of a search

CANDIDATE_POSES = 400
HOLD_TIME = 2.0  # s in each pose, or to and fro
MAX_POSES = 60  # poses
PRIOR_SHARE = 1e-3  # information that is taken as known before, as a share of what a mean candidate gives
RANK_TOLERANCE = 1e-8  # of the largest singular value: what is less is not shown by gravity
PASS_SPEED_FACTOR = 2.0  # times what a fit leaves out as too slow
JERK_DURATION = 0.1  # s that the jerk acts on the way to that speed and back, twice each: gently


class _JointSweeps(Noun):
    """Sweeps of a joint from its ``pose`` (n) over the free range in one direction (rad, m), and their speeds."""

    pose: Array
    joint: int
    room: float
    speeds: Array
    ramp: Ramp

    def sweeps(self, steady_time: float) -> Iterator[Sweep]:
        """Yield a sweep there and one back for each speed, which is kept for ``steady_time`` (s) if there is room."""
        direction = np.eye(len(self.pose))[self.joint]
        for speed in self.speeds.tolist():
            # with little room the sweep is as long as it fits, else as long as its constant speed lasts
            distance = min(self.room, speed * (steady_time + self.ramp.duration(speed)))
            forward_sweep = Sweep(self.pose, direction, distance, speed, self.ramp)
            yield forward_sweep
            yield replace(forward_sweep, pose=forward_sweep.end, distance=-distance)

    def total_time(self, steady_time: float) -> float:
        """Return the time (s) that all sweeps take."""
        return sum(sweep.duration for sweep in self.sweeps(steady_time))


def friction_program(
    feasible: Feasibility, duration: float, start: Array | None, rng: np.random.Generator, speeds: int = 5
) -> tuple[Piece, ...]:
    """Return each joint moving alone at as many ``speeds``, in both directions, within ``duration`` (s).

    The arm begins and ends in the pose ``start`` (n; None: chosen). The speeds of a joint are spread evenly in the
    logarithm, from a twentieth of the greatest that it can keep for a while, but from above the speeds that a fit
    leaves out as too slow. Raises ConfigError where the time does not suffice, or a joint cannot move.
    """
    pose, free_ranges = _roomiest_pose(feasible, start, rng)
    home = pose if start is None else start
    runs = [_plan_sweeps(feasible, pose, joint, ends, speeds) for joint, ends in enumerate(free_ranges)]
    paths_there = [_path_pieces(feasible, pose, run.pose, rng) for run in runs]
    paths_back = [_path_pieces(feasible, run.pose, pose, rng) for run in runs]
    first_path, last_path = _path_pieces(feasible, home, pose, rng), _path_pieces(feasible, pose, home, rng)
    path_time = sum(
        piece.course.duration for path in (*paths_there, *paths_back, first_path, last_path) for piece in path
    )
    # the time that paths leave is divided so that each speed is kept equally long
    steady_time = _steady_time(runs, duration, path_time)
    pieces = list(first_path)
    for run, path_there, path_back in zip(runs, paths_there, paths_back, strict=True):
        name = feasible.limits.joints[run.joint]
        sweeps = (Piece(sweep, Purpose.FRICTION, name) for sweep in run.sweeps(steady_time))
        pieces += [*path_there, *sweeps, *path_back]
    return (*pieces, *last_path)


def _roomiest_pose(
    feasible: Feasibility, start: Array | None, rng: np.random.Generator
) -> tuple[Array, list[tuple[float, float]]]:
    """Return the pose (n) in which the joint with the least room of its range has most, and the free range of each."""
    poses = feasible.random_poses(POSE_TRIALS, rng)
    if start is not None:
        poses = np.concatenate([[start], poses])
    free_ranges = [[_free_range(feasible, pose, joint) for joint in range(len(pose))] for pose in poses]
    shares = np.array([[high - low for low, high in ends] for ends in free_ranges]) / (2 * feasible.limits.half)
    # the joint with the least room decides, the mean of all breaks ties
    best = int((shares.min(axis=1) + shares.mean(axis=1) / len(shares[0])).argmax())
    return poses[best], free_ranges[best]


def _free_range(feasible: Feasibility, pose: Array, joint: int) -> tuple[float, float]:
    """Return the ends of the range in which a joint can stand anywhere, around its position in a pose (n)."""
    limits = feasible.limits
    positions = np.sort(np.append(np.linspace(limits.lower[joint], limits.upper[joint], JOINT_POSITIONS), pose[joint]))
    poses = np.tile(pose, (len(positions), 1))
    poses[:, joint] = positions
    blocked = np.flatnonzero(~feasible.can_stand(poses))
    current = int(np.searchsorted(positions, pose[joint]))
    # nearest blocked position on either side of the joint's own
    low = blocked[blocked < current].max(initial=-1) + 1
    high = blocked[blocked > current].min(initial=len(positions)) - 1
    return float(positions[min(low, current)]), float(positions[max(high, current)])


def _plan_sweeps(
    feasible: Feasibility, pose: Array, joint: int, ends: tuple[float, float], speeds: int
) -> _JointSweeps:
    """Return the sweeps of a joint in its free range, as fast as it can keep for a while and its torque allows."""
    limits, (low, high) = feasible.limits, ends
    start_pose, room = pose.copy(), high - low
    start_pose[joint] = low
    speed_limit, acceleration, jerk = (float(size[joint]) for size in limits.sizes[1:])
    ramp = Ramp(acceleration, jerk, feasible.step)
    min_speed = MIN_SPEED_FACTOR * float(min_fit_speeds(feasible.model, limits)[joint])
    for _ in range(MAX_TRIES):
        fastest = _fastest_speed(room, speed_limit, ramp)
        slowest_speed = min(max(MIN_SPEED_RATIO * fastest, min_speed), fastest)
        rates = np.geomspace(slowest_speed, fastest, speeds)
        run = _JointSweeps(start_pose, joint, room, rates, ramp)
        # the last two sweeps are the fastest, there and back: slower ones need less torque
        if room > 0 and all(map(feasible.allows, list(run.sweeps(np.inf))[-2:])):
            return run
        ramp = Ramp(ACCELERATION_FACTOR * ramp.acceleration, ACCELERATION_FACTOR * ramp.jerk, ramp.step)
        speed_limit *= SPEED_FACTOR
    raise ConfigError(
        f"joint {limits.joints[joint]!r} cannot sweep alone between {low:.4g} and {high:.4g}, where it is free in the "
        "best of the poses that were tried: its torque or the clearance does not allow it."
    )


def _fastest_speed(room: float, limit: float, ramp: Ramp) -> float:
    """Return the greatest speed up to a limit that is constant for ``MIN_STEADY_SHARE`` of the range ``room``."""
    speed = limit
    for _ in range(SEARCH_STEPS):
        if speed * ramp.duration(speed) <= (1 - MIN_STEADY_SHARE) * room:
            break
        speed *= 0.9
    return speed


class TooShortError(ConfigError):
    """A ``program`` has less time than the ``shortest`` that it takes (s)."""

    def __init__(self, program: str, shortest: float) -> None:
        super().__init__(f"{program}; set `duration` to {np.ceil(shortest):g} s or more, or choose another program.")
        self.program, self.shortest = program, shortest


def _steady_time(runs: list[_JointSweeps], duration: float, path_time: float) -> float:
    """Return the time (s) for which each speed is kept, so that the program takes the duration."""
    shortest = path_time + sum(run.total_time(MIN_STEADY_TIME) for run in runs)
    if shortest > duration:
        raise TooShortError(
            f"the friction program takes {shortest:.1f} s for {len(runs)} joints, {path_time:.1f} s of it between "
            f"sweeps, but has {duration:.1f} s", shortest,
        )  # fmt: skip
    low, high = MIN_STEADY_TIME, duration
    # bisection: the total time grows with the time at constant speed
    for _ in range(SEARCH_STEPS):
        middle = (low + high) / 2
        is_in_time = path_time + sum(run.total_time(middle) for run in runs) <= duration
        low, high = (middle, high) if is_in_time else (low, middle)
    return low


def _path_pieces(feasible: Feasibility, start: Array, end: Array, rng: np.random.Generator) -> tuple[Piece, ...]:
    path = find_path(feasible, start, end, rng)
    if path is None:
        pose_words = join_names(f"{name} {x:.3g}" for name, x in zip(feasible.limits.joints, end, strict=True))
        raise ConfigError(f"no way was found that is free and within the limits, to the pose {pose_words}.")
    return path


def select_informative_poses(feasible: Feasibility, poses: Array, weights: Array, count: int) -> list[int]:
    """Return the indices of ``count`` of the poses (K, n), in the order in which they add most information.

    Each adds most to log det of the information on what the torque at rest shows; ``weights`` (n) are 1 / sigma^2
    by joint. To and fro along one way the torque is as far above that at rest as below, so that it shows the same
    of gravity. V. V. Fedorov, "Theory of optimal experiments", 1972: the gain is log det(I + Z P Z').
    """
    zeros = np.zeros_like(poses)
    rows = feasible.model.regressor(poses, zeros, zeros) * np.sqrt(weights)[:, None]
    # whiten by the mean information of the candidates: all directions count alike, and those that are not shown drop
    # out
    _, singular_values, basis = np.linalg.svd(
        rows.reshape(-1, rows.shape[2]) / np.sqrt(len(poses)), full_matrices=False
    )
    is_shown = singular_values > RANK_TOLERANCE * singular_values[0]
    Z = rows @ (basis[is_shown] / singular_values[is_shown, None]).T  # (M, n, r), of mean information I
    indices: list[int] = []
    # a vague prior keeps the first gains finite
    P = np.eye(Z.shape[2]) / PRIOR_SHARE
    for _ in range(min(count, len(poses))):
        gains = np.linalg.slogdet(np.eye(Z.shape[1]) + Z @ P @ Z.transpose(0, 2, 1))[1]
        gains[indices] = -np.inf
        # a pose is taken once at most
        indices.append(int(gains.argmax()))
        pose_rows = Z[indices[-1]]
        # Woodbury: covariance after the rows of the pose
        P = P - P @ pose_rows.T @ np.linalg.solve(np.eye(len(pose_rows)) + pose_rows @ P @ pose_rows.T, pose_rows @ P)
    return indices


def gravity_program(feasible: Feasibility, request: MotionRequest, rng: np.random.Generator) -> tuple[Piece, ...]:
    """Return as many poses, each for 2 s, as a request has time for, with the ways between them, from and to its start
    (none: the first of them). Raises ConfigError where the time does not suffice for one."""
    duration, start, weights = request.duration, request.start, np.asarray(1 / np.square(request.sigma))
    count = max(1, min(MAX_POSES, int(duration / HOLD_TIME)))
    visits = _plan_visits(feasible, weights, count, rng)
    tour = _Tour(feasible, visits, visits[0][0].pose if start is None else start, rng)
    stops = list(range(1, len(visits) + 1))
    while stops:
        pieces, stops = tour.pieces(stops)
        total_time = sum(piece.course.duration for piece in pieces)
        if stops and total_time <= duration:
            return pieces
        # the time is too long: drop the least informative stops, about half of the excess at once
        stops = stops[: -max(1, int(len(stops) * (1 - duration / total_time) / 2))] if stops else []
    raise ConfigError(
        f"the gravity program has {duration:.1f} s, too little to reach a pose, stay for {HOLD_TIME:g} s and return; "
        "give it more time."
    )


Visit = tuple[Hold] | tuple[Sweep, Sweep]  # what the arm does in a pose, from a place at rest back to it


def _plan_visits(feasible: Feasibility, weights: Array, count: int, rng: np.random.Generator) -> tuple[Visit, ...]:
    """Return at most ``count`` visits of poses that may be driven, the most informative first."""
    poses = feasible.random_poses(CANDIDATE_POSES, rng)
    velocity = (
        PASS_SPEED_FACTOR * min_fit_speeds(feasible.model, feasible.limits) * rng.choice((-1.0, 1.0), poses.shape)
    )
    if not velocity.any():
        rest = float(round_up(np.array(HOLD_TIME), feasible.step))
        return tuple((Hold(rest, poses[k]),) for k in select_informative_poses(feasible, poses, weights, count))
    sweeps = [_sweep_to_and_fro(feasible, *pair) for pair in zip(poses, velocity, strict=True)]
    ends = np.array([(forward.pose, forward.end) for forward, _ in sweeps])
    free = np.flatnonzero(feasible.can_stand(ends[:, 0]) & feasible.can_stand(ends[:, 1]))
    allowed = [k for k in free if all(map(feasible.allows, sweeps[k]))]
    if not allowed:
        raise ConfigError(
            f"in none of {len(poses)} poses can all joints with dry friction move slowly to and fro; check the limits, "
            "and what is in the way."
        )
    return tuple(sweeps[allowed[k]] for k in select_informative_poses(feasible, poses[allowed], weights, count))


def _sweep_to_and_fro(feasible: Feasibility, pose: Array, velocity: Array) -> tuple[Sweep, Sweep]:
    """Return sweeps through a pose (n) and back at a constant velocity (n), which take ``HOLD_TIME`` or longer."""
    speeds = np.abs(velocity)
    with np.errstate(divide="ignore"):
        bounds = (feasible.limits.sizes[2:] / speeds).min(axis=1)
    # in units of the way: the joint with the tightest limit decides
    acceleration, jerk = min(1 / JERK_DURATION, float(bounds[0])), min(1 / JERK_DURATION**2, float(bounds[1]))
    ramp = Ramp(acceleration, jerk, feasible.step)
    distance = max(HOLD_TIME / 2 - ramp.duration(1.0), 2 * ramp.duration(1.0))
    forward = Sweep(pose - distance / 2 * velocity, velocity, distance, 1.0, ramp)
    return forward, replace(forward, pose=forward.end, distance=-distance)


class _Tour(Noun):
    """Visits, which begin and end at their stops, and a home pose (n) before and after them; stop 0 is the home."""

    feasible: Feasibility
    visits: tuple[Visit, ...]
    home: Array
    rng: np.random.Generator
    paths: dict[tuple[int, int], tuple[Piece, ...] | None] = field(default_factory=dict)

    def pieces(self, stops: list[int]) -> tuple[tuple[Piece, ...], list[int]]:
        """Return the pieces from home by the stops back to it, always to the nearest one, and the stops that are left.

        Stops that no path leads to are left out; those that remain are in their order of importance.
        """
        tour, remaining, velocity = [0], set(stops), self.feasible.limits.velocity
        while remaining:
            # nearest neighbour: not the shortest tour, but near it and cheap
            place = self._stop_pose(tour[-1])
            nearest = min(remaining, key=lambda k: np.abs((self._stop_pose(k) - place) / velocity).max())
            remaining.remove(nearest)
            if self._path(tour[-1], nearest) is not None:
                tour.append(nearest)
        # leave out the last stops until there is a path home
        while len(tour) > 1 and self._path(tour[-1], 0) is None:
            tour.pop()
        pieces: list[Piece] = []
        for origin, target in pairwise([*tour, 0]):
            pieces += self._path(origin, target) or ()
            visit: tuple[Course, ...] = self.visits[target - 1] if target else ()
            pieces += [Piece(course, Purpose.POSE, str(tour.index(target))) for course in visit]
        return tuple(pieces), [k for k in stops if k in tour]

    def _stop_pose(self, k: int) -> Array:
        return self.visits[k - 1][0].pose if k else self.home

    def _path(self, origin: int, target: int) -> tuple[Piece, ...] | None:
        if (origin, target) not in self.paths:
            self.paths[origin, target] = find_path(
                self.feasible, self._stop_pose(origin), self._stop_pose(target), self.rng
            )
        return self.paths[origin, target]
