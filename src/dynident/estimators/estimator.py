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
    """What decided a parameter: the data, the prior, a bound that it lies at, or nothing."""

    DATA = "data"
    PRIOR = "prior"
    BOUND = "bound"
    UNIDENTIFIABLE = "unidentifiable"


@dataclass(frozen=True, eq=False)
class Problem:
    """What an estimator may need: the model, the motions to fit, their linear problem, and the logs as measured.

    ``logs`` may be empty: the positions of the motions then stand for the measured ones. The motions are those that the
    logs show ``time_offset`` (s) late; the logs themselves are as stamped.
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
    column-scaled regressor; ``notes`` say what was not as it should be, none where all is well.

    Where the estimator can tell: ``provenance`` (p) says what each parameter was determined by; ``eigenvalues`` is the
    smallest eigenvalue of each body's pseudo-inertia, relative to the body's usual mass (kg) and length (m); ``costs``
    is what each family of constraints alone, and "all" of them, add to the weighted relative error of the training data
    (percentage points of the torque); ``interval`` (p, 2) are the ends of 95 % intervals that need not be symmetric,
    empty (0, 2) where two standard errors are all that is known; ``weights`` (n) are what each joint's rows
    were multiplied with, None where all count the same; ``sample_weights`` holds for each motion of the regression what
    its rows (N, n) were multiplied with besides, empty where all count the same, and ``slopes`` (N, n) the derivative
    of w^2 e by the residual e where the weights w depend on it (empty: w^2); ``information`` (p, p) is Fisher's of all,
    where the errors of the motion count, too; ``directions`` are those that the data determine, of which the rank is
    the number; ``unconstrained`` (p) is a solution of the same fit without constraints, None where it has none. What
    constraints moved a value by may be its error, and counts as such in the covariance.
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
    unconstrained: Array | None = None

    @property
    def std(self) -> Array:
        """Standard errors (p)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def converged(self) -> bool:
        """Whether the search, if there was one, ended at its optimum."""
        return not any(isinstance(note, Unsettled) for note in self.notes)


class Estimator(Protocol):
    """Frozen configuration; the data come only in the call."""

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate the parameters of the problem's model."""


@runtime_checkable
class HasQuick(Protocol):
    """An estimator with a stand-in for searches that try many values, such as that of the time offset."""

    def quick(self) -> Estimator:
        """Return an estimator of the same kind of error, as fast as least squares."""


def quick(estimator: Estimator) -> Estimator:
    """Return the stand-in of an estimator for searches: its own, or itself where it has none."""
    return estimator.quick() if isinstance(estimator, HasQuick) else estimator
