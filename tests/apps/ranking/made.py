"""A slider on two days, and parts that fail in all the ways a part can, in a module that workers can import."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from dynident.estimators import Estimate, Estimator, LeastSquares, LinearFit, Problem
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Difference, Smoother
from dynident.runtime import InputError, MissingInputError

MASS, FRICTION = 5.0, 8.0  # kg, N s/m
CONFIG = """
model: gallery:slider
time: { column: t, unit: s }
position: { slider: { column: x, unit: m } }
torque: { slider: { column: f, unit: N } }
time_offset: 0
smoother: { kind: spline }
train: [{ file: monday.csv }]
"""


def make_project(folder: Path, *, held_out: bool = True, seconds: float = 8.0, more: str = "") -> Path:
    """Write the recordings and the configuration of a slider, and return its path."""
    rng, t = np.random.default_rng(0), np.arange(round(100 * seconds)) * 0.01
    for day, w in (("monday", 3.0), ("tuesday", 4.0)):
        x = np.sin(w * t) + 0.3 * np.sin(2.3 * w * t)
        dx = w * np.cos(w * t) + 0.69 * w * np.cos(2.3 * w * t)
        ddx = -(w**2) * np.sin(w * t) - 0.3 * (2.3 * w) ** 2 * np.sin(2.3 * w * t)
        force = MASS * ddx + FRICTION * dx + rng.standard_normal(len(t))
        table = np.column_stack([t, x + 1e-4 * rng.standard_normal(len(t)), force])
        np.savetxt(folder / f"{day}.csv", table, delimiter=",", header="t,x,f", comments="")
    text = CONFIG + ("validation: [{ file: tuesday.csv }]\n" if held_out else "") + more
    path = folder / "robot.yaml"
    path.write_text(text)
    return path


@dataclass(frozen=True)
class Raising(Estimator):
    """An estimator that raises what is no error of dynident."""

    def __call__(self, problem: Problem) -> Estimate:
        raise ZeroDivisionError(f"no estimate of {problem.model.name}")


@dataclass(frozen=True)
class Lacking(Estimator):
    """An estimator that needs what no log has."""

    def __call__(self, problem: Problem) -> Estimate:
        raise MissingInputError(f"{problem.logs[0].source}: has no controller; give its gains.")


@dataclass(frozen=True)
class Halved(Estimator):
    """Least squares, of which half is left."""

    def __call__(self, problem: Problem) -> Estimate:
        result = LeastSquares()(problem)
        return replace(result, value=result.value / 2)


@dataclass(frozen=True)
class Whole(Estimator):
    """An estimator that works on all samples only, and so not in cross-validation."""

    samples: int

    def __call__(self, problem: Problem) -> Estimate:
        if sum(int(motion.mask.sum()) for motion in problem.motions) < self.samples:
            raise InputError("too few samples")
        return LeastSquares()(problem)


@dataclass(frozen=True)
class Counting(LeastSquares):
    """Least squares that counts how often it reduces the rows of a problem."""

    calls: ClassVar[list[int]] = []

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the rows."""
        self.calls.append(problem.regression.usable_samples)
        return super().reduced(problem)


@dataclass(frozen=True)
class Greedy(Smoother):
    """A smoother that leaves out nearly all samples."""

    def __call__(self, log: Log) -> Motion:
        motion = Difference("central")(log)
        return replace(motion, mask=np.arange(len(motion)) < 20)


@dataclass(frozen=True)
class OnMonday(Smoother):
    """A smoother that is made for one day only."""

    def __call__(self, log: Log) -> Motion:
        if log.source != "monday":
            raise MissingInputError(f"{log.source} is another day.")
        return Difference("central")(log)

    def substitute(self) -> Difference:
        """Forward differences, for all other days."""
        return Difference()


@dataclass(frozen=True)
class Stuck(Smoother):
    """A smoother that cannot smooth."""

    def __call__(self, log: Log) -> Motion:
        raise InputError(f"{log.source}: nothing is smooth enough")
