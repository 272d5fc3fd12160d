"""What estimators that simulate have to say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynident.errors import Note, Severity
from dynident.estimators.notes import Unsettled

__all__ = ["StartedConsistent", "StillSimulating"]


@dataclass(frozen=True)
class StartedConsistent(Note):
    """The iteration began with the physically consistent fit, as the model of least squares cannot be simulated."""

    severity: ClassVar[Severity] = Severity.INFO


@dataclass(frozen=True)
class StillSimulating(Unsettled):
    """After so many ``iterations`` of simulation the parameters still move, by ``moved`` standard errors at last."""

    iterations: int
    moved: float
