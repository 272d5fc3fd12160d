"""A motion as a function of time, in pieces that follow each other with continuous q, dq and ddq."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Course", "Piece", "Purpose", "Trajectory"]

Array = NDArray[np.float64]


class Course(Protocol):
    """A motion of n joints from time 0 to its duration (s), smooth within."""

    @property
    def duration(self) -> float:
        """Its length (s)."""

    def states(self, t: Array, /) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N) within 0 and the duration."""


class Purpose(StrEnum):
    """What a piece is for: the way to its start, the optimised motion, one joint at constant speeds, a pose at rest."""

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

    @property
    def duration(self) -> float:
        """The length (s) of all pieces."""
        return sum(piece.course.duration for piece in self.pieces)

    def states(self, t: Array) -> Array:
        """Return q, dq, ddq and the jerk, shape (4, N, n), at times t (N)."""
        raise NotImplementedError
