"""A motion as a function of time, in pieces that follow each other with continuous q, dq and ddq."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, brief

__all__ = ["Course", "Piece", "Purpose", "Trajectory"]

Array = NDArray[np.float64]
EPSILON = 1e-9  # of a time: as good as equal


class Course(Protocol):
    """A motion of n joints from time 0 to its duration (s), smooth within."""

    @property
    def duration(self) -> float:
        """Its length (s)."""

    def states(self, t: Array, /) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N) within 0 and the duration."""


class Purpose(StrEnum):
    """What a piece is for: the way to its start, the optimised motion, one joint at constant speeds, a pose for gravity
    (held, or passed slowly)."""

    WAY = "way"
    MOTION = "motion"
    FRICTION = "friction"
    POSE = "pose"


@dataclass(frozen=True)
class Piece:
    """A course with its purpose; ``label`` says which (the joint, the number of the pose)."""

    course: Course
    purpose: Purpose
    label: str = ""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Pieces one after the other, from rest to rest, of the named joints."""

    joints: tuple[str, ...]
    pieces: tuple[Piece, ...]

    __repr__ = brief

    def __post_init__(self) -> None:
        if not self.pieces:
            raise ConfigError("a trajectory has no pieces; give at least one.")

    @cached_property
    def edges(self) -> Array:
        """The times (P + 1) in s at which the P pieces begin, and the end."""
        return np.concatenate([[0.0], np.cumsum([piece.course.duration for piece in self.pieces])])

    @property
    def duration(self) -> float:
        """The length (s) of all pieces."""
        return float(self.edges[-1])

    @cached_property
    def once(self) -> Trajectory:
        """The same without the pieces that repeat the course of the one before, such as all periods but the first."""
        return Trajectory(self.joints, tuple(self.pieces[k] for k in self.firsts))

    @cached_property
    def firsts(self) -> tuple[int, ...]:
        """The places of the pieces that do not repeat the course of the one before."""
        before = (None, *(piece.course for piece in self.pieces))
        return tuple(k for k, piece in enumerate(self.pieces) if piece.course is not before[k])

    def first_time(self, t: float) -> float:
        """Return the first time (s) at which the arm is where ``once`` is at t."""
        k = int(np.clip(np.searchsorted(self.once.edges, t, side="right") - 1, 0, len(self.firsts) - 1))
        return float(self.edges[self.firsts[k]] + t - self.once.edges[k])

    def times(self, rate: float) -> Array:
        """Return times in s, at ``rate`` (Hz) from 0, and the end."""
        t = np.arange(int(np.floor(self.duration * rate * (1 + EPSILON))) + 1) / rate
        return t if self.duration - t[-1] <= EPSILON * self.duration else np.append(t, self.duration)

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N); at rest before it begins and after it ends.

        At the time where two pieces meet the later one counts.
        """
        t = np.asarray(t, dtype=float)
        out = np.empty((4, len(t), len(self.joints)))
        which = np.clip(np.searchsorted(self.edges, t, side="right") - 1, 0, len(self.pieces) - 1)
        order = np.argsort(which, kind="stable")
        for mine in np.split(order, np.flatnonzero(np.diff(which[order])) + 1) if len(t) else ():
            k = int(which[mine[0]])
            course = self.pieces[k].course
            out[:, mine] = course.states(np.clip(t[mine] - self.edges[k], 0.0, course.duration))
        out[1:, (t < 0) | (t > self.duration)] = 0.0
        return out
