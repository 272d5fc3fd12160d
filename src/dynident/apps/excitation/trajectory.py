"""A motion as a function of time, in pieces that follow each other with continuous q, dq and ddq."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from dynident.models import Distances
from dynident.models.geometry import LipschitzDistances
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

TIME_TOLERANCE = 1e-9  # of a time: as good as equal
STEP_TOLERANCE = 1e-6  # of a step, likewise
COARSE_RATE = 50.0  # Hz
SUBDIVISIONS, FINE_LEVELS = 5, 2  # in which an interval is divided, twice: 1250 Hz
MAX_LEVELS = 4  # times it is divided where the clearance is not proven: 31 kHz
PROOF_TOLERANCE = 1e-4  # m: less than the clearance by this is as good
FINAL_POINTS = 20  # parts, about the smallest distance found
SPEED_SAFETY = 2.0  # on the speed that a pair has shown


class Course(Protocol):
    """Motion of n joints from time 0 to its duration (s), smooth within."""

    @property
    def duration(self) -> float:
        """Its length (s)."""

    def states(self, t: Array, /) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N) within 0 and the duration."""


class Purpose(StrEnum):
    """Purpose of a piece.

    The path to its start, the optimised motion, one joint at constant speeds, or a pose for gravity (held,
    or passed slowly).
    """

    WAY = "way"
    MOTION = "motion"
    FRICTION = "friction"
    POSE = "pose"


@dataclass(frozen=True)
class Piece:
    """A course with its purpose; ``label`` tells which one it is (the joint, the number of the pose)."""

    course: Course
    purpose: Purpose
    label: str = ""


class Trajectory(Noun):
    """Pieces one after the other, from rest to rest, of the named joints."""

    joints: tuple[str, ...]
    pieces: tuple[Piece, ...]

    @cached_property
    def edges(self) -> Array:
        """Times (P + 1) in s at which the P pieces begin, and the end."""
        return np.concatenate([[0.0], np.cumsum([piece.course.duration for piece in self.pieces])])

    @property
    def duration(self) -> float:
        """The length (s) of all pieces."""
        return float(self.edges[-1])

    @cached_property
    def without_repeats(self) -> Trajectory:
        """The same trajectory without pieces that repeat the course before, such as all periods but the first."""
        return Trajectory(self.joints, tuple(self.pieces[k] for k in self.first_indices))

    @cached_property
    def first_indices(self) -> tuple[int, ...]:
        """Indices of the pieces that do not repeat the course before."""
        before = (None, *(piece.course for piece in self.pieces))
        # repeated periods share one course object
        return tuple(k for k, piece in enumerate(self.pieces) if piece.course is not before[k])

    def first_time(self, t: float) -> float:
        """Return the first time (s) at which the arm is where ``without_repeats`` is at t."""
        edges = self.without_repeats.edges
        k = int(np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(self.first_indices) - 1))
        return float(self.edges[self.first_indices[k]] + t - edges[k])

    def times(self, rate: float) -> Array:
        """Return times in s, at ``rate`` (Hz) from 0, and the end."""
        t = np.arange(int(np.floor(self.duration * rate * (1 + TIME_TOLERANCE))) + 1) / rate
        return t if self.duration - t[-1] <= TIME_TOLERANCE * self.duration else np.append(t, self.duration)

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N); at rest before it begins and after it ends.

        Where two pieces meet, the later one counts.
        """
        t = np.asarray(t, dtype=float)
        out = np.empty((4, len(t), len(self.joints)))
        piece_index = np.clip(np.searchsorted(self.edges, t, side="right") - 1, 0, len(self.pieces) - 1)
        order = np.argsort(piece_index, kind="stable")
        # group the times by piece, so that each course is evaluated once
        for rows in np.split(order, np.flatnonzero(np.diff(piece_index[order])) + 1) if len(t) else ():
            k = int(piece_index[rows[0]])
            course = self.pieces[k].course
            out[:, rows] = course.states(np.clip(t[rows] - self.edges[k], 0.0, course.duration))
        out[1:, (t < 0) | (t > self.duration)] = 0.0
        return out


class SlowedCourse(Noun):
    """A ``course`` that takes ``times`` as long: dq, ddq and the jerk are divided by times, its square and its cube."""

    course: Course
    times: float

    @property
    def duration(self) -> float:
        """Its length (s)."""
        return self.times * self.course.duration

    def states(self, t: Array, /) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        length = self.course.duration
        states = self.course.states(np.clip(np.asarray(t, dtype=float) / self.times, 0.0, length))
        return states / self.times ** np.arange(4.0)[:, None, None]


def slow_down(trajectory: Trajectory, times: float) -> Trajectory:
    """Return the same path, ``times`` as long."""
    pieces = (replace(piece, course=SlowedCourse(piece.course, times)) for piece in trajectory.pieces)
    return replace(trajectory, pieces=tuple(pieces))


@dataclass(frozen=True, order=True)
class ClosestApproach:
    """Smallest distance (m), the pair that it is between, and its time (s); the closest is the least."""

    distance: float
    pair: tuple[str, str]
    time: float


def closest_approach(space: Distances, trajectory: Trajectory, clearance: float) -> ClosestApproach | None:
    """Return the smallest distance along a trajectory, None where no pair is watched.

    The distances are sampled at 50 Hz, and finer, up to 1250 Hz, where a pair may come below the
    ``clearance`` (m) or below the smallest distance found, and there at 25 kHz at last; and up to 31 kHz
    until no pair can come below the clearance by 0.1 mm. The rate at which a distance may fall is known for
    ``LipschitzDistances``; else it is twice the rate that was observed around that time.
    """
    if not space.pairs:
        return None
    times = np.linspace(0.0, trajectory.duration, max(2, int(np.ceil(trajectory.duration * COARSE_RATE)) + 1))
    step = float(times[1])
    states = trajectory.states(times)
    distances = space.distances(states[0])
    best = _closest_sample(space, times, distances)
    if isinstance(space, LipschitzDistances):
        speed = _speed_bounds(space, states, step)
    else:
        speed = _observed_speeds(distances, step)
    starts, lower = times[:-1], np.minimum(distances[:-1], distances[1:])
    for level in range(MAX_LEVELS):
        # first look for the smallest distance itself, then only prove the clearance
        bound = max(clearance, best.distance) if level < FINE_LEVELS else clearance - PROOF_TOLERANCE
        # within an interval a distance falls by at most speed times half the interval
        may_be_near = (lower - speed * step / 2 <= bound).any(axis=1)
        fine_times = starts[may_be_near, None] + step * np.linspace(0.0, 1.0, SUBDIVISIONS + 1)
        if not fine_times.size:
            break
        distances = space.distances(trajectory.states(fine_times.ravel())[0]).reshape(*fine_times.shape, -1)
        best = min(best, _closest_sample(space, fine_times.ravel(), distances.reshape(fine_times.size, -1)))
        step, speed = step / SUBDIVISIONS, np.repeat(speed[may_be_near], SUBDIVISIONS, axis=0)
        starts = fine_times[:, :-1].ravel()
        lower = np.minimum(distances[:, :-1], distances[:, 1:]).reshape(-1, distances.shape[2])
    # the smallest distance found is refined around its time
    last_times = np.clip(best.time + step * np.linspace(-1.0, 1.0, 2 * FINAL_POINTS + 1), 0.0, trajectory.duration)
    return min(best, _closest_sample(space, last_times, space.distances(trajectory.states(last_times)[0])))


def _observed_speeds(d: Array, h: float) -> Array:
    """Return twice the rates (K, P) observed in and around intervals of h (s), from distances d (K + 1, P)."""
    speed = np.abs(np.diff(d, axis=0)) / h
    # the speed in neighbouring intervals counts, too: a distance may turn between samples
    padded = np.pad(speed, ((1, 1), (0, 0)))
    return SPEED_SAFETY * np.maximum(np.maximum(padded[:-2], padded[2:]), speed)


def _speed_bounds(space: LipschitzDistances, states: Array, h: float) -> Array:
    """Return bounds of the rates (K, P) of pairs in intervals of h (s) between states (4, K + 1, n)."""
    dq, ddq, jerk = np.maximum(np.abs(states[1:, :-1]), np.abs(states[1:, 1:]))
    return np.asarray((dq + h / 2 * (ddq + h / 2 * jerk)) @ space.steepest.T)


def _closest_sample(space: Distances, t: Array, d: Array) -> ClosestApproach:
    row, pair = np.unravel_index(int(d.argmin()), d.shape)
    return ClosestApproach(float(d[row, pair]), space.pairs[pair], float(t[row]))


class Hold(Noun):
    """An arm that stands still in a ``pose`` (n) for a ``duration`` (s)."""

    duration: float
    pose: Array

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        out = np.zeros((4, len(t), len(self.pose)))
        out[0] = self.pose
        return out


def round_up(durations: Array, step: float) -> Array:
    """Return durations (s) as whole multiples of a ``step`` (s), longer rather than shorter; as they are where it is 0.

    Where pieces begin and end at written points, what is played between the points is the motion itself.
    """
    return np.asarray(step * np.ceil(durations / step - STEP_TOLERANCE) if step else durations)


class Ramp(NamedTuple):
    """How a joint comes from rest to a speed: ``acceleration`` and ``jerk`` are not exceeded, and the jerk acts for a
    while, then the full acceleration, then the jerk again, each for whole multiples of ``step`` (s)."""

    acceleration: float
    jerk: float
    step: float

    def times(self, speed: float) -> tuple[float, float]:
        """Return the time (s) for which the jerk acts, and that of full acceleration."""
        # at low speeds the acceleration does not reach its limit
        reaches_limit = speed * self.jerk >= self.acceleration**2
        ramp = self.acceleration / self.jerk if reaches_limit else float(np.sqrt(speed / self.jerk))
        steady = speed / self.acceleration - ramp if reaches_limit else 0.0
        return float(round_up(np.array(ramp), self.step)), float(round_up(np.array(steady), self.step))

    def duration(self, speed: float) -> float:
        """Return the time (s) from rest to a speed; up and down again, a joint moves by the speed times it."""
        ramp, steady = self.times(speed)
        return 2 * ramp + steady


class Sweep(Noun):
    """An arm that moves from rest in a ``pose`` (n) to rest, by ``distance`` times ``direction`` (n).

    In between it has a constant ``speed``, to which it comes by the ``ramp``, and back, all along the direction. The
    distance is at least that of speeding up and slowing down, and is made less, so that all parts take whole multiples
    of the ramp's step.
    """

    pose: Array
    direction: Array
    distance: float
    speed: float
    ramp: Ramp

    @property
    def duration(self) -> float:
        """Its length (s)."""
        return float(self._way.x[-1])

    @property
    def cruise(self) -> float:
        """How long (s) the speed is constant."""
        longest, step = max(0.0, abs(self.distance) / self.speed - self.ramp.duration(self.speed)), self.ramp.step
        return step * np.floor(longest / step + STEP_TOLERANCE) if step else longest

    @property
    def end(self) -> Array:
        """The pose (n) in which it ends."""
        length = self.speed * (self.ramp.duration(self.speed) + self.cruise)
        return np.asarray(self.pose + np.copysign(length, self.distance) * self.direction)

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        t = np.asarray(t, dtype=float)
        out = np.stack([self._way(t, nu=d) for d in range(4)])[:, :, None] * self.direction
        out[0] += self.pose
        return np.asarray(out)

    @cached_property
    def _way(self) -> PPoly:
        """The way (rad or m) along the direction by time (s), in parts of constant jerk: ramp, cruise, ramp."""
        from scipy.interpolate import PPoly

        ramp, steady = self.ramp.times(self.speed)
        jerk = min(self.ramp.jerk, self.speed / (ramp * (ramp + steady)))  # less where the ramps are in whole steps
        lengths = np.array([ramp, steady, ramp, self.cruise, ramp, steady, ramp])
        jerks = np.copysign(jerk, self.distance) * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
        edges = np.concatenate([[0.0], np.cumsum(lengths[lengths > 0])])
        return PPoly(jerks[None, lengths > 0], edges).antiderivative(3)
