"""The protocol of an estimator: Problem -> Estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note
from dynident.estimators.notes import Unsettled
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.regression import Rank, Regression

__all__ = ["Estimate", "Estimator", "HasQuick", "Problem", "Provenance", "quick"]

Array = NDArray[np.float64]


class Provenance(StrEnum):
    """What determines a parameter: the data, the prior, an active bound, or nothing."""

    DATA = "data"
    PRIOR = "prior"
    BOUND = "bound"
    UNIDENTIFIABLE = "unidentifiable"


@dataclass(frozen=True, eq=False)
class Problem:
    """The input of an estimator: the model, the motions to fit, their linear problem, and the logs as measured.

    ``logs`` may be empty: the positions of the motions are then used as the measured ones. The positions of the logs
    are stamped ``time_offset`` (s) later than the torque; the motions are corrected for it, the logs are not.
    """

    model: Model
    motions: tuple[Motion, ...]
    regression: Regression
    logs: tuple[Log, ...] = ()
    time_offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with their uncertainty.

    ``value`` (p) in the units ``units``; ``covariance`` (p, p), infinite variance where the data do not determine a
    parameter; ``sigma`` (n) standard deviation of each joint's torque residual; ``rank`` and ``condition`` of the
    column-scaled regressor; ``notes`` report problems, none where there are none.

    Where the estimator provides them: ``provenance`` (p) says what determines each parameter; ``eigenvalues`` are the
    smallest eigenvalues of the bodies' pseudo-inertias, relative to the usual mass (kg) and length (m) of the body;
    ``costs`` are the increase of the weighted relative error of the training data (percentage points of the torque) by
    each family of constraints alone, and by "all"; ``interval`` (p, 2) are the ends of 95 % intervals, which need not
    be symmetric, empty (0, 2) where only standard errors are known; ``weights`` (n) of the rows of each joint, None for
    equal weights; ``sample_weights`` (N, n) further weights of the rows of each motion, empty for equal weights, and
    ``slopes`` (N, n) the derivative of w^2 e with respect to the residual e where the weights w depend on it (empty:
    w^2); ``information`` (p, p) is Fisher's information, where errors of the motion are taken into account;
    ``directions`` are those that the data determine; their number is the rank.
    """

    value: Array
    covariance: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    sigma: Array
    rank: int
    condition: float
    samples: int
    notes: tuple[Note, ...] = ()
    provenance: tuple[Provenance, ...] = ()
    eigenvalues: Mapping[str, float] = field(default_factory=dict)
    costs: Mapping[str, float] = field(default_factory=dict)
    interval: Array = field(default_factory=lambda: np.zeros((0, 2)))
    weights: Array | None = None
    sample_weights: tuple[Array, ...] = ()
    slopes: tuple[Array, ...] = ()
    information: Array | None = None
    directions: Rank | None = None

    @property
    def std(self) -> Array:
        """Standard errors (p)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def converged(self) -> bool:
        """Whether the iteration, if there was one, converged."""
        return not any(isinstance(note, Unsettled) for note in self.notes)


class Estimator(Protocol):
    """A frozen dataclass of settings; calling it with the data gives the estimate."""

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate the parameters of the problem's model."""


@runtime_checkable
class HasQuick(Protocol):
    """An estimator with a fast substitute for searches over many trial values, such as that of the time offset."""

    def quick(self) -> Estimator:
        """Return an estimator that minimises a similar error, as fast as least squares."""


def quick(estimator: Estimator) -> Estimator:
    """Return the fast substitute of an estimator for searches, or itself where it has none."""
    return estimator.quick() if isinstance(estimator, HasQuick) else estimator
