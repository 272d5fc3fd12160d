"""The notes that an estimate carries: what the data left open, how a likelihood ended, what was done to the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynident.errors import Note, Severity

__all__ = [
    "Averaged",
    "DecidedByPrior",
    "Failed",
    "HeldByConstraints",
    "MovingStart",
    "NotAlone",
    "NotByData",
    "NotConverged",
    "NotIdentifiable",
    "NotWhite",
    "PriorApproached",
    "RankDeficient",
    "ScatterLarger",
    "SmoothSigns",
    "Undetermined",
    "Unsettled",
]


@dataclass(frozen=True)
class Undetermined(Note):
    """Base of what the rank leaves open; of a robot's inertial parameters that is no news, as no motion shows all."""


@dataclass(frozen=True)
class Unsettled(Note):
    """Base of the ends of a search that is not at its optimum."""


@dataclass(frozen=True)
class RankDeficient(Undetermined):
    """The data determine ``rank`` combinations of so many ``parameters``.

    ``without_effect`` names those with no effect on the torque, ``tied`` the groups that cannot be told apart, where
    the estimator looks for them.
    """

    rank: int
    parameters: int
    without_effect: tuple[str, ...] = ()
    tied: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class NotAlone(Undetermined):
    """Parameters that the data do not determine by themselves."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class NotByData(Undetermined):
    """So many parameters are not decided by the data alone."""

    count: int


@dataclass(frozen=True)
class DecidedByPrior(Undetermined):
    """So many parameters are decided by the prior where the data leave them free."""

    count: int


@dataclass(frozen=True)
class NotIdentifiable(Undetermined):
    """So many parameters are decided by neither data nor prior where the data leave them free."""

    count: int


@dataclass(frozen=True)
class HeldByConstraints(Note):
    """Constraints keep base parameters far from where the data alone would have them: formula, standard errors."""

    severity: ClassVar[Severity] = Severity.INFO
    moved: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class PriorApproached(Undetermined):
    """The barrier method stopped at a duality ``gap`` from the parameters nearest to the prior."""

    gap: float


@dataclass(frozen=True)
class NotConverged(Unsettled):
    """The search ended after ``iterations`` steps; the log-likelihood may still rise by ``gain``."""

    iterations: int
    gain: float


@dataclass(frozen=True)
class Failed(Unsettled):
    """Maximum likelihood failed for a ``reason`` (the error's message), and the estimate is its start."""

    reason: str


@dataclass(frozen=True)
class NotWhite(Note):
    """The torque's residuals have a ``correlation`` of neighbouring samples: the model leaves out more than noise."""

    correlation: float


@dataclass(frozen=True)
class ScatterLarger(Note):
    """By the residuals' scatter in time the standard error of a ``parameter`` is ``ratio`` times as large."""

    parameter: str
    ratio: float


@dataclass(frozen=True)
class MovingStart(Note):
    """The likelihood ratio says, with so small a ``p_value``, that the recordings do not start from rest."""

    severity: ClassVar[Severity] = Severity.INFO
    p_value: float


@dataclass(frozen=True)
class Averaged(Note):
    """Of ``group`` neighbouring samples the mean was taken."""

    severity: ClassVar[Severity] = Severity.INFO
    group: int


@dataclass(frozen=True)
class SmoothSigns(Note):
    """The sign of velocities in friction was made smooth, tanh(dq / width), with these ``widths`` (rad/s or m/s)."""

    severity: ClassVar[Severity] = Severity.INFO
    widths: tuple[float, ...]
