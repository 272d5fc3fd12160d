"""The design of a motion: the most informative one within the limits, and what it will tell."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, brief
from dynident.excitation.expected import Expected
from dynident.excitation.limits import MotionLimits
from dynident.excitation.request import Request
from dynident.excitation.space import Space
from dynident.excitation.trajectory import Trajectory

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["Design", "design"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Design:
    """A motion, another one for validation, and what the first is expected to tell.

    ``theta`` (p) are the parameters of the ``model`` that give the torque, ``request`` and ``limits`` as used.
    """

    model: Model
    theta: Array
    request: Request
    limits: MotionLimits
    space: Space
    trajectory: Trajectory
    validation: Trajectory
    expected: Expected
    notes: tuple[Note, ...] = ()

    __repr__ = brief


def design(
    model: Model,
    theta: Array,
    limits: MotionLimits,
    space: Space,
    request: Request,
    rng: np.random.Generator,
    *,
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
) -> Design:
    """Return the most informative motion that keeps to the limits; ``theta`` (p) gives the torque."""
    raise NotImplementedError
