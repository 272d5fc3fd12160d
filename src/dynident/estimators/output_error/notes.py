"""What estimators that simulate have to say."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from dynident.errors import Note, Severity
from dynident.estimators.notes import Unsettled

__all__ = ["Start", "StartedElsewhere", "StillSimulating"]


class Start(StrEnum):
    """With what a simulation began: least squares of a smoothing spline or of a Kalman smoother, instrumental
    variables, the physically consistent fit, values of the robot file."""

    SMOOTHED = "smoothed"
    KALMAN = "kalman"
    CONSISTENT = "consistent"
    INSTRUMENTS = "instruments"
    NOMINAL = "nominal"


@dataclass(frozen=True)
class StartedElsewhere(Note):
    """The iteration began with other values, as with those of least squares the simulation fails, or is farther off."""

    severity: ClassVar[Severity] = Severity.INFO
    start: Start


@dataclass(frozen=True)
class StillSimulating(Unsettled):
    """After so many ``iterations`` of simulation the parameters still move, by ``moved`` standard errors at last."""

    iterations: int
    moved: float
