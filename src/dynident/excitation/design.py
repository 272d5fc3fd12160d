"""The design of a motion: the most informative one within the limits, and what it will tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, brief
from dynident.excitation.limits import MotionLimits
from dynident.excitation.request import Request
from dynident.excitation.space import Space
from dynident.excitation.trajectory import Trajectory
from dynident.regression import BaseParameters

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["Design", "Expected", "design"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Expected:
    """What a recording of a motion is expected to tell: of the base parameters ``basis`` (b) their ``value`` (b), the
    standard errors ``std`` (b), infinite for those that stay open, log det and the condition number of the
    information."""

    basis: BaseParameters
    value: Array
    std: Array
    log_det: float
    condition: float

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Design:
    """A motion, another one for validation, and what the first is expected to tell.

    ``request`` and ``limits`` as used; ``checked`` is what the independent check of both has found.
    """

    model: Model
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


def expected(model: Model, theta: Array, parts: Sequence[Array], request: Request) -> Expected:
    """Return what sampled motions (4, N, n) are expected to tell."""
    raise NotImplementedError
