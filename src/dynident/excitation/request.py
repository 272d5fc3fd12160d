"""What a motion is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Criterion", "Program", "Request"]

Array = NDArray[np.float64]


class Program(StrEnum):
    """What the arm does: the optimised motion, each joint at constant speeds, poses for gravity, or all of these."""

    MOTION = "motion"
    FRICTION = "friction"
    GRAVITY = "gravity"
    ALL = "all"


class Criterion(StrEnum):
    """What is optimised: the volume of the confidence region (D), the sum of relative variances of named parameters,
    or of all in units of what random states show (A), the condition number."""

    D_OPTIMAL = "d"
    A_OPTIMAL = "a"
    CONDITION = "condition"


@dataclass(frozen=True, eq=False)
class Request:
    """A motion of at most ``duration`` (s), recorded at ``rate`` (Hz) with torque noise ``sigma`` (n), N m or N.

    ``family``: "fourier" or "bspline"; ``period`` (s) of the series and its ``harmonics``; ``start`` (n) is the pose at
    rest where it begins and ends (None: chosen); ``named`` parameters for the A-optimal criterion (none: all base
    parameters); ``prior`` (p, p) is information on the parameters that is known before; ``starts`` of the search;
    ``clearance`` (m) is kept to all.
    """

    sigma: Array
    program: Program = Program.MOTION
    criterion: Criterion = Criterion.D_OPTIMAL
    family: str = "fourier"
    duration: float = 30.0
    period: float = 5.0
    harmonics: int = 5
    rate: float = 250.0
    start: Array | None = None
    named: tuple[str, ...] = ()
    prior: Array | None = None
    starts: int = 8
    clearance: float = 0.01

    __repr__ = brief
