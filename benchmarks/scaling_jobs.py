"""Jobs that compute nothing, for benchmarks/scaling.py; workers import this file."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from dynident.estimators import DataRank, Estimate, Residual
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import Recording


@dataclass(frozen=True)
class Still:
    """A scenario and a method at once that compute nothing: what is left is the cost of the rest."""

    name: str = "still"

    def record(self, level: float, rng: np.random.Generator) -> Recording:  # noqa: ARG002
        return None  # type: ignore[return-value]

    def estimate(self, recording: Recording) -> Estimate:  # noqa: ARG002
        arm = two_link_arm()
        ones = np.ones(len(arm.parameters))
        return Estimate(arm.parameters, ones, np.diag(ones), DataRank(len(ones)), Residual(ones[:2], 100))


@dataclass(frozen=True)
class Wait:
    """A job that takes as long as a fit, and no CPU."""

    seconds: float

    def __call__(self, job: int) -> int:
        if self.seconds:
            time.sleep(self.seconds)
        return job
