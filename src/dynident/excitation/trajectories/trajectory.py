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
        for k in np.unique(which):
            mine, course = which == k, self.pieces[k].course
            out[:, mine] = course.states(np.clip(t[mine] - self.edges[k], 0.0, course.duration))
        out[1:, (t < 0) | (t > self.duration)] = 0.0
        return out
