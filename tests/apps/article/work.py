"""Scenarios and methods of small studies, in a module that workers can import."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dynident.estimators import DataRank, Estimate, Residual
from dynident.models import Parameter
from dynident.models.simulation import Recording, record
from dynident.motion.log import Log, Motion
from dynident.runtime import InputError

if TYPE_CHECKING:
    import polars as pl

LEVELS = (0.1, 0.2)
HANGS = 600.0  # s: nothing takes as long, even on a busy machine
SEEN = (Parameter("q", "rad"), Parameter("tau", "N m"))


@dataclass(frozen=True)
class Still:
    """A joint at rest at 2 rad, under a torque of 3 N m."""

    name: str = "still"

    def record(self, level: float, rng: np.random.Generator) -> Recording:
        t, ones = np.arange(50) * 0.01, np.ones((50, 1))
        truth = Motion(t, 2 * ones, 0 * ones, 0 * ones, 3 * ones, ("a",), np.ones(50, bool))
        return record(truth, level, level, rng)


@dataclass(frozen=True)
class Mean:
    """Estimates the position and the torque by their means; breaks on demand."""

    name: str = "mean"
    breaks_above: float = np.inf

    def estimate(self, recording: Recording) -> Estimate:
        log: Log = recording.log
        value = np.array([log.q.mean(), log.tau.mean()])
        if value[0] > self.breaks_above:
            raise ValueError("too large")
        return Estimate(SEEN, value, np.eye(2), DataRank(2), Residual(np.ones(1), 50))


@dataclass(frozen=True)
class Trouble:
    """What its name says, at the higher noise; else a mean."""

    name: str

    def estimate(self, recording: Recording) -> Estimate:
        if recording.sigma_q[0] == LEVELS[1]:
            getattr(self, self.name)()
        return Mean().estimate(recording)

    def raises(self) -> None:
        raise InputError("no")

    def hangs(self) -> None:
        time.sleep(HANGS)

    def eats(self) -> None:
        bytearray(10_000_000_000)

    def ends(self) -> None:
        os._exit(7)


TROUBLES = [Trouble(name) for name in ("raises", "hangs", "eats", "ends")]


def without_seconds(table: pl.DataFrame) -> pl.DataFrame:
    return table.drop("seconds")
