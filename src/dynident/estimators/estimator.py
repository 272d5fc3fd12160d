"""The protocol of an estimator: Problem -> Estimate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.log import Motion
from dynident.model import Model
from dynident.regression import Regression

__all__ = ["Estimate", "Estimator", "Problem"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Problem:
    """What an estimator may need: the model, the motions to fit, and their linear problem."""

    model: Model
    motions: tuple[Motion, ...]
    regression: Regression


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with their uncertainty.

    ``value`` (p) in the units ``units``; ``covariance`` (p, p), infinite variance where the data do not determine a
    parameter; ``sigma`` (n) standard deviation of each joint's torque residual; ``rank`` and ``condition`` of the
    column-scaled regressor; ``status`` says in words how it went, "ok" where all is well.
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

    @property
    def std(self) -> Array:
        """Standard errors (p)."""
        return np.sqrt(np.diag(self.covariance))


class Estimator(Protocol):
    """Frozen configuration; the data come only in the call."""

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate the parameters of the problem's model."""
