"""Each joint alone at several constant speeds, to and fro over the same way, so that gravity cancels; slow to fast."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, listed
from dynident.excitation.trajectories.dry_friction import slowest
from dynident.excitation.trajectories.feasibility import Feasibility
from dynident.excitation.trajectories.sweep import Sweep, run_up
from dynident.excitation.trajectories.trajectory import Piece, Purpose
from dynident.excitation.trajectories.way import way

__all__ = ["friction_program"]

Array = NDArray[np.float64]
POSES, PLACES = 24, 33  # poses that are tried, and positions of each joint there
SLOWEST = 0.05  # of the greatest speed
ABOVE = 1.5  # times what a fit leaves out as too slow, at least
STEADY = 0.4  # of its way that a joint is at its constant speed at least
FLEETING = 0.1  # s at a constant speed: less shows nothing
GENTLER, SLOWER = 0.5, 0.9  # of acceleration and jerk, and of the speed, where the torque does not suffice
TRIES = 6
SEARCH = 40  # steps of a search


@dataclass(frozen=True, eq=False)
class _Run:
    """A joint, the free way from its ``pose`` (n) in one direction (rad, m), and how it moves."""

    pose: Array
    joint: int
    room: float
    speeds: Array
    acceleration: float
    jerk: float

    def sweeps(self, steady: float) -> Iterator[Sweep]:
        """Yield a way there and one back for each speed, which is constant for ``steady`` s where there is room."""
        direction = np.eye(len(self.pose))[self.joint]
        for speed in self.speeds.tolist():
            ramp, full = run_up(speed, self.acceleration, self.jerk)
            distance = min(self.room, speed * (steady + 2 * ramp + full))
            there = Sweep(self.pose, direction, distance, speed, self.acceleration, self.jerk)
            yield there
            yield Sweep(there.end, direction, -distance, speed, self.acceleration, self.jerk)

    def time(self, steady: float) -> float:
        """Return how long (s) all sweeps take."""
        return sum(one.duration for one in self.sweeps(steady))


def friction_program(
    feasible: Feasibility, duration: float, start: Array | None, rng: np.random.Generator, speeds: int = 5
) -> tuple[Piece, ...]:
    """Return each joint moving alone at so many ``speeds`` in both directions, from and to the pose ``start`` (n; None:
    chosen), within ``duration`` (s).

    The speeds of a joint are spread evenly in the logarithm, from a twentieth of the greatest that it can keep for a
    while, but from above what a fit leaves out as too slow. Raises ConfigError where the time does not suffice, or a
    joint cannot move.
    """
    pose, free = _roomiest(feasible, start, rng)
    home = pose if start is None else start
    runs = [_run(feasible, pose, joint, ends, speeds) for joint, ends in enumerate(free)]
    there = [_way(feasible, pose, run.pose, rng) for run in runs]
    back = [_way(feasible, run.pose, pose, rng) for run in runs]
    first, last = _way(feasible, home, pose, rng), _way(feasible, pose, home, rng)
    spent = sum(piece.course.duration for part in (*there, *back, first, last) for piece in part)
    steady = _steady(runs, duration, spent)
    pieces = list(first)
    for run, to, fro in zip(runs, there, back, strict=True):
        name = feasible.limits.joints[run.joint]
        pieces += [*to, *(Piece(one, Purpose.FRICTION, name) for one in run.sweeps(steady)), *fro]
    return (*pieces, *last)


def _roomiest(
    feasible: Feasibility, start: Array | None, rng: np.random.Generator
) -> tuple[Array, list[tuple[float, float]]]:
    """Return the pose (n) in which the joint with the least room of its range has most, and the free way of each."""
    poses = feasible.poses(POSES, rng)
    if start is not None:
        poses = np.concatenate([[start], poses])
    free = [[_free(feasible, pose, joint) for joint in range(len(pose))] for pose in poses]
    shares = np.array([[high - low for low, high in ends] for ends in free]) / (2 * feasible.limits.half)
    best = int((shares.min(axis=1) + shares.mean(axis=1) / len(shares[0])).argmax())
    return poses[best], free[best]


def _free(feasible: Feasibility, pose: Array, joint: int) -> tuple[float, float]:
    """Return the ends between which a joint can stand anywhere, about where it is in a pose (n)."""
    limits = feasible.limits
    places = np.sort(np.append(np.linspace(limits.lower[joint], limits.upper[joint], PLACES), pose[joint]))
    many = np.tile(pose, (len(places), 1))
    many[:, joint] = places
    blocked = np.flatnonzero(~feasible.stands(many))
    here = int(np.searchsorted(places, pose[joint]))
    low, high = blocked[blocked < here].max(initial=-1) + 1, blocked[blocked > here].min(initial=len(places)) - 1
    return float(places[min(low, here)]), float(places[max(high, here)])


def _run(feasible: Feasibility, pose: Array, joint: int, ends: tuple[float, float], speeds: int) -> _Run:
    """Return how a joint moves in its free way: as fast as it can keep for a while, and its torque allows."""
    limits, (low, high) = feasible.limits, ends
    begin, room = pose.copy(), high - low
    begin[joint] = low
    limit, acceleration, jerk = (float(size[joint]) for size in limits.sizes[1:])
    above = ABOVE * float(slowest(feasible.model, limits)[joint])
    for _ in range(TRIES):
        fastest = _fastest(room, limit, acceleration, jerk)
        slow = min(max(SLOWEST * fastest, above), fastest)
        run = _Run(begin, joint, room, np.geomspace(slow, fastest, speeds), acceleration, jerk)
        if room > 0 and all(map(feasible.allows, list(run.sweeps(np.inf))[-2:])):
            return run
        acceleration, jerk, limit = GENTLER * acceleration, GENTLER * jerk, SLOWER * limit
    raise ConfigError(
        f"joint {limits.joints[joint]!r} cannot sweep alone between {low:.4g} and {high:.4g}, where it is free in the "
        "best of the poses that were tried: its torque or the clearance does not allow it."
    )


def _fastest(room: float, limit: float, acceleration: float, jerk: float) -> float:
    """Return the greatest speed up to a limit that is constant for the share ``STEADY`` of the way ``room``."""
    speed = limit
    for _ in range(SEARCH):
        ramp, full = run_up(speed, acceleration, jerk)
        if speed * (2 * ramp + full) <= (1 - STEADY) * room:
            break
        speed *= 0.9
    return speed


def _steady(runs: list[_Run], duration: float, spent: float) -> float:
    """Return for how long (s) each speed is kept, so that all takes the duration."""
    least = spent + sum(run.time(FLEETING) for run in runs)
    if least > duration:
        raise ConfigError(
            f"the friction program takes {least:.1f} s for {len(runs)} joints, {spent:.1f} s of it for ways, but has "
            f"{duration:.1f} s; give it more time, or choose another program."
        )
    low, high = FLEETING, duration
    for _ in range(SEARCH):
        middle = (low + high) / 2
        low, high = (middle, high) if spent + sum(run.time(middle) for run in runs) <= duration else (low, middle)
    return low


def _way(feasible: Feasibility, start: Array, end: Array, rng: np.random.Generator) -> tuple[Piece, ...]:
    found = way(feasible, start, end, rng)
    if found is None:
        where = listed(f"{name} {x:.3g}" for name, x in zip(feasible.limits.joints, end, strict=True))
        raise ConfigError(f"no way was found that is free and within the limits, to the pose {where}.")
    return tuple(Piece(one, Purpose.WAY) for one in found)
