"""What estimators that simulate have to say."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.estimators.notes import Unsettled

__all__ = ["StillSimulating"]


@dataclass(frozen=True)
class StillSimulating(Unsettled):
    """After so many ``iterations`` of simulation the parameters still move, by ``moved`` standard errors at last."""

    iterations: int
    moved: float
