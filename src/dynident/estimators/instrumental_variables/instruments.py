"""Instruments of a recording: motions at its samples whose errors are independent of those of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.estimators.estimator import Problem
from dynident.estimators.instrumental_variables.notes import InstrumentKind
from dynident.log import Motion
from dynident.regression import Regression, fitted_rows

__all__ = ["Instruments", "paired"]


@dataclass(frozen=True, eq=False)
class Instruments:
    """A ``motion`` at the samples of another one, usable where its mask is True; its ``kind`` and ``lag`` (s).

    Of another pass ``other`` is the place of its recording, and ``partner`` (N) its sample for each, -1 for none.
    """

    motion: Motion
    kind: InstrumentKind
    lag: float | None = None
    other: int | None = None
    partner: NDArray[np.intp] | None = None

    __repr__ = brief


def paired(problem: Problem, instruments: Sequence[Instruments]) -> tuple[Regression, Regression]:
    """Return the rows of a problem that have instruments, and those of the instruments: the same samples of both."""
    given, rows, others = problem.regression, [], []
    for motion, one in zip(given.motions, instruments, strict=True):
        mask, keep = motion.mask & one.motion.mask, fitted_rows(motion, given.min_speed)
        rows.append(replace(motion, mask=mask, keep=keep))
        others.append(replace(one.motion, mask=mask, keep=keep))
    both = (replace(given, motions=tuple(some), min_speed=None) for some in (rows, others))
    first, second = both
    return first, second
