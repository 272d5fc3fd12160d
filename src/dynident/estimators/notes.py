"""The notes of an estimate: what the data do not determine, how an iteration ended, how the data were changed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from dynident.runtime import Note, Severity, Use

MAX_ERROR_PERCENT = 50.0  # %


class FirstModel(StrEnum):
    """The first model of a simulation or a filter.

    Least squares of a smoothing spline or of a Kalman smoother, instrumental variables, the physically consistent
    fit, values of the robot file, or least squares with a positive definite mass matrix.
    """

    SMOOTHED = "smoothed"
    KALMAN = "kalman"
    CONSISTENT = "consistent"
    INSTRUMENTS = "instruments"
    NOMINAL = "nominal"
    MASS = "mass"


@dataclass(frozen=True)
class Undetermined(Note):
    """Base of the notes on a deficient rank, which is normal for inertial parameters: no motion determines all."""


@dataclass(frozen=True)
class Unsettled(Note):
    """Base of the notes on an iteration that did not converge."""


@dataclass(frozen=True)
class RankDeficient(Undetermined):
    """The data determine ``rank`` combinations of so many ``parameters``.

    ``without_effect`` names those with no effect on the torque, ``tied`` the groups of which only combinations are
    identifiable; both are empty where the estimator does not compute them.
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
    """``count`` parameters are not determined by the data alone."""

    count: int


@dataclass(frozen=True)
class DecidedByPrior(Undetermined):
    """``count`` parameters are determined by the prior where the data do not determine them."""

    count: int


@dataclass(frozen=True)
class DrawnToPrior(Note):
    """The estimate is drawn to the prior with a ``strength`` that cross-validation chose."""

    severity: ClassVar[Severity] = Severity.INFO
    strength: float


@dataclass(frozen=True)
class ErrorsInRegressor(Note):
    """Along one direction, errors make up ``percent`` of what the regressor shows (its sum of squares).

    The direction is mostly that of ``parameter``. The estimate there rests on the stated size of the errors;
    where the share is more than half, the parameters are unfit for any use.
    """

    parameter: str
    percent: float

    @property
    def forbidden(self) -> Use | None:
        """Any use, where there is more error than motion."""
        return Use.CONTROL if self.percent > MAX_ERROR_PERCENT else None


@dataclass(frozen=True)
class NotIdentifiable(Undetermined):
    """``count`` parameters are determined by neither data nor prior."""

    count: int


@dataclass(frozen=True)
class HeldByConstraints(Note):
    """Constraints hold base parameters far from where the data alone would have them: formula, standard errors."""

    severity: ClassVar[Severity] = Severity.INFO
    moved: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class ConstraintsCostly(Note):
    """The constraints raise the weighted training error (%) from ``free`` to ``error``, mostly those of ``family``."""

    family: str
    error: float
    free: float


@dataclass(frozen=True)
class MotionCorrected(Note):
    """Errors of the smoothed motion would bias a base ``parameter`` by ``size`` standard errors; they are corrected."""

    severity: ClassVar[Severity] = Severity.INFO
    parameter: str
    size: float


@dataclass(frozen=True)
class LimitedByMotion(Note):
    """The remaining bias by errors of the smoothed motion dominates some standard errors.

    That is so for ``limited`` of ``all`` base parameters, above all for ``parameter``.
    """

    severity: ClassVar[Severity] = Severity.INFO
    parameter: str
    limited: int
    all: int


@dataclass(frozen=True)
class MotionTooNoisy(Note):
    """Errors of the smoothed motion bias a base ``parameter`` by ``size`` standard errors: too much to correct."""

    parameter: str
    size: float


@dataclass(frozen=True)
class PriorApproached(Undetermined):
    """The barrier method stopped at a duality ``gap`` before the parameters nearest to the prior."""

    gap: float


@dataclass(frozen=True)
class NotConverged(Unsettled):
    """The iteration stopped after ``iterations`` steps; the log-likelihood may still increase by ``gain``."""

    iterations: int
    gain: float


@dataclass(frozen=True)
class StillMoving(Unsettled):
    """The iteration stopped after ``iterations`` steps, the last one ``change`` standard errors of all together."""

    iterations: int
    change: float


@dataclass(frozen=True)
class StillSimulating(Unsettled):
    """After so many ``iterations`` of simulation the parameters still move, by ``moved`` standard errors at last."""

    iterations: int
    moved: float


@dataclass(frozen=True)
class Downweighted(Note):
    """By joint, the share of the torques that count less than half, because they look wrong."""

    severity: ClassVar[Severity] = Severity.INFO
    joints: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Failed(Unsettled):
    """Maximum likelihood failed for a ``reason`` (the error's message), and the estimate is its start."""

    reason: str


@dataclass(frozen=True)
class NotWhite(Note):
    """The torque residuals have a ``correlation`` between neighbouring samples: they are more than noise."""

    correlation: float


@dataclass(frozen=True)
class ScatterLarger(Note):
    """The standard error of a ``parameter`` is ``ratio`` times as large by the scatter of the residuals over time."""

    parameter: str
    ratio: float


@dataclass(frozen=True)
class MovingStart(Note):
    """The recordings do not start from rest, by a likelihood ratio test with this ``p_value``."""

    severity: ClassVar[Severity] = Severity.INFO
    p_value: float


@dataclass(frozen=True)
class Averaged(Note):
    """Averages of ``group`` neighbouring samples were used."""

    severity: ClassVar[Severity] = Severity.INFO
    group: int


@dataclass(frozen=True)
class SmoothSigns(Note):
    """The sign of the velocity in friction was replaced by tanh(dq / width), with these ``widths`` (rad/s or m/s)."""

    severity: ClassVar[Severity] = Severity.INFO
    widths: tuple[float, ...]


@dataclass(frozen=True)
class StartedElsewhere(Note):
    """The iteration began with another first model, as that of least squares cannot be simulated, or is farther off."""

    severity: ClassVar[Severity] = Severity.INFO
    start: FirstModel


@dataclass(frozen=True)
class StillColoured(Note):
    """The whitened residual of a ``joint`` has a ``correlation`` over time: no such noise describes it."""

    joint: str
    correlation: float


@dataclass(frozen=True)
class WhiteningCostly(Note):
    """The fit to whitened rows leaves ``ratio`` times as much of the torque of a ``joint`` as least squares.

    Where such noise does not do that by ``chance``, what counts as noise there follows the motion, and is what the
    model lacks: the parameters may be many standard errors off.
    """

    joint: str
    ratio: float
    chance: bool = False

    @property
    def forbidden(self) -> Use | None:
        """Simulation, where chance does not explain it."""
        return None if self.chance else Use.SIMULATION
