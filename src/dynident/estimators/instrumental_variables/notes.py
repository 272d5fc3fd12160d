"""What instrumental variables have to say of their instruments."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from dynident.errors import Note, Severity
from dynident.estimators.notes import Unsettled

__all__ = ["InstrumentKind", "InstrumentsUsed", "MotionMovesOn", "NotSimulated", "WeakInstruments"]


class InstrumentKind(StrEnum):
    """Where instruments are from: a simulation, another pass of the same motion, other samples of the same motion."""

    SIMULATED = "simulated"
    REPEATED = "repeated"
    LAGGED = "lagged"


@dataclass(frozen=True)
class InstrumentsUsed(Note):
    """The ``kinds`` of instruments, the longest ``lag`` (s) of those that have one, and what became of least squares.

    ``correlation`` is the least between instruments and regressor; the value of ``parameter`` is the one that is moved
    most, by ``moved`` standard errors; none where no parameter is determined by itself.
    """

    severity: ClassVar[Severity] = Severity.INFO
    kinds: tuple[InstrumentKind, ...]
    correlation: float
    lag: float | None = None
    parameter: str | None = None
    moved: float = 0.0


@dataclass(frozen=True)
class WeakInstruments(Note):
    """The instruments explain little of the regressor in a direction of which ``parameter`` has the largest part:
    their ``correlation``, and the F ``statistic`` of the first stage."""

    parameter: str
    correlation: float
    statistic: float


@dataclass(frozen=True)
class NotSimulated(Note):
    """Instruments are not simulated, as the first model fails in the controller's loop, for a ``reason``."""

    reason: str


@dataclass(frozen=True)
class MotionMovesOn(Unsettled):
    """The simulated motion, and with it the value, still moves after so many ``iterations``: by ``moved`` standard
    errors in the last one. Where a simulation failed, the ``reason`` says why."""

    iterations: int
    moved: float
    reason: str = ""
