"""The protocol of an estimator: Problem -> Estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.log import Log, Motion
from dynident.model import Model
from dynident.rank import Rank
from dynident.regression import Regression

__all__ = ["Estimate", "Estimator", "Problem", "Verdict"]

Array = NDArray[np.float64]
Verdict = Literal["data", "prior", "bound", "unidentifiable"]


@dataclass(frozen=True, eq=False)
class Problem:
    """What an estimator may need: the model, the motions to fit, their linear problem, and the logs as measured.

    ``logs`` may be empty: the positions of the motions then stand for the measured ones. The motions are those that the
    logs show ``delay`` (s) late; the logs themselves are as stamped.
    """

    model: Model
    motions: tuple[Motion, ...]
    regression: Regression
    logs: tuple[Log, ...] = ()
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with their uncertainty.

    ``value`` (p) in the units ``units``; ``covariance`` (p, p), infinite variance where the data do not determine a
    parameter; ``sigma`` (n) standard deviation of each joint's torque residual; ``rank`` and ``condition`` of the
    column-scaled regressor; ``status`` says in words how it went, "ok" where all is well, and ``remarks`` what of that
    a user must know of any model, besides what the rank leaves open.

    Where the estimator can tell: ``verdict`` (p) says what each parameter was determined by; ``eigenvalues`` is the
    smallest eigenvalue of each body's pseudo-inertia, relative to the body's usual mass (kg) and length (m); ``costs``
    is what each family of constraints alone, and "all" of them, add to the weighted relative error of the training data
    (percentage points of the torque); ``interval`` (p, 2) are the ends of 95 % intervals that need not be symmetric,
    empty (0, 2) where two standard errors are all that is known; ``weights`` (n) are what each joint's rows
    were multiplied with, None where all count the same; ``information`` (p, p) is Fisher's of all, where the errors
    of the motion count, too; ``directions`` are those that the data determine, of which the rank is the number.
    """

    value: Array
    covariance: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    sigma: Array
    rank: int
    condition: float
    samples: int
    status: str = "ok"
    remarks: tuple[str, ...] = ()
    verdict: tuple[Verdict, ...] = ()
    eigenvalues: Mapping[str, float] = field(default_factory=dict)
    costs: Mapping[str, float] = field(default_factory=dict)
    interval: Array = field(default_factory=lambda: np.zeros((0, 2)))
    weights: Array | None = None
    information: Array | None = None
    directions: Rank | None = None

    @property
    def std(self) -> Array:
        """Standard errors (p)."""
        return np.sqrt(np.diag(self.covariance))


class Estimator(Protocol):
    """Frozen configuration; the data come only in the call."""

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate the parameters of the problem's model."""
