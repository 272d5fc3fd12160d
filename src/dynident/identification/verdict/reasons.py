"""The reasons against a use of a model, each with its figures and a remedy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynident.errors import Finding
from dynident.identification.verdict.steps import HoldOutFaster, Remedy, Step
from dynident.simulation import Failure
from dynident.validation import Driver

__all__ = [
    "FreeRunAstray",
    "FreeRunFails",
    "HeldBack",
    "InertiasFree",
    "JointErrorsTooLarge",
    "MassMatrixNotPositive",
    "MostlyUnexcited",
    "NegativeValues",
    "NoFreeRun",
    "NoHoldOut",
    "NotCarriedOver",
    "Noted",
    "PartlyUnexcited",
    "Reason",
    "Repeats",
    "SilentTorque",
    "SlowHoldOut",
    "TorqueErrorTooLarge",
    "TrainedWorse",
    "UnfilteredErrorTooLarge",
]


@dataclass(frozen=True)
class Reason:
    """Base of the reasons; errors are in %."""

    usual_remedy: ClassVar[Remedy | None] = None

    @property
    def remedy(self) -> Remedy | Step | None:
        """What to do about it, None where there is no single remedy."""
        return self.usual_remedy


@dataclass(frozen=True)
class NoHoldOut(Reason):
    """No log was held out."""

    usual_remedy = Remedy.HOLD_OUT


@dataclass(frozen=True)
class Noted(Reason):
    """What the checks found, or the estimate notes, that forbids a use: ``findings`` of one kind."""

    usual_remedy = Remedy.CORRECT
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class Repeats(Reason):
    """All held-out logs repeat a motion of the training: ``pairs`` of their names."""

    usual_remedy = Remedy.ANOTHER_MOTION
    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class SlowHoldOut(Reason):
    """The held-out motions have at most ``share`` of the speed of the training, so that little is seen of inertia."""

    share: float

    @property
    def remedy(self) -> Step | None:
        """A motion as fast as the training; any other where the held-out one does not move."""
        return HoldOutFaster(1.0 / self.share) if self.share > 0 else None


@dataclass(frozen=True)
class SilentTorque(Reason):
    """The torque of these ``joints`` does not change in any training log."""

    usual_remedy = Remedy.TORQUE_COLUMN
    joints: tuple[str, ...]


@dataclass(frozen=True)
class TorqueErrorTooLarge(Reason):
    """The torque ``error`` on a held-out ``log`` exceeds the ``limit``."""

    usual_remedy = Remedy.CHECK
    log: str
    error: float
    limit: float


@dataclass(frozen=True)
class UnfilteredErrorTooLarge(TorqueErrorTooLarge):
    """The same of the torque as measured, where the fit has a low-pass."""


@dataclass(frozen=True)
class JointErrorsTooLarge(Reason):
    """Single joints have a torque error above the ``limit``: pairs of name and error."""

    usual_remedy = Remedy.LONGER_TRAINING
    log: str
    errors: tuple[tuple[str, float], ...]
    limit: float


@dataclass(frozen=True)
class NotCarriedOver(Reason):
    """The error on a held-out ``log`` is ``ratio`` times that of the training."""

    usual_remedy = Remedy.LONGER_TRAINING
    log: str
    ratio: float


@dataclass(frozen=True)
class TrainedWorse(Reason):
    """The ``error`` on a training ``log`` is large, ``ratio`` times that held out: the fit has outliers, or a fault."""

    usual_remedy = Remedy.CHECK
    log: str
    error: float
    ratio: float


@dataclass(frozen=True)
class MassMatrixNotPositive(Reason):
    """The mass matrix has an ``eigenvalue`` that is not positive."""

    usual_remedy = Remedy.CONSISTENT_FIT
    eigenvalue: float


@dataclass(frozen=True)
class MostlyUnexcited(Reason):
    """The data do not excite so many of the ``total`` base parameters that the model is of no use."""

    usual_remedy = Remedy.EXCITE
    unexcited: int
    total: int


@dataclass(frozen=True)
class PartlyUnexcited(Reason):
    """The data do not excite some of the ``total`` base parameters; motions that do are not predicted."""

    unexcited: int
    total: int


@dataclass(frozen=True)
class HeldBack(Reason):
    """Physical constraints hold the parameters far from what the data say.

    Without them the residual would be smaller: it is ``growth`` % larger. On the training motion at twice its speed the
    torque would differ by ``apart`` %.
    """

    usual_remedy = Remedy.CHECK
    growth: float
    apart: float


@dataclass(frozen=True)
class DrawnBack(HeldBack):
    """A prior holds them there, without any constraint."""


@dataclass(frozen=True)
class NegativeValues(Reason):
    """Parameters with ``names`` are negative, which is not physical."""

    usual_remedy = Remedy.CONSISTENT_FIT
    names: tuple[str, ...]


@dataclass(frozen=True)
class InertiasFree(Reason):
    """The bodies' inertias were not constrained to be physically consistent."""

    usual_remedy = Remedy.CONSISTENT_FIT


@dataclass(frozen=True)
class NoFreeRun(Reason):
    """No free simulation was asked for."""

    usual_remedy = Remedy.SIMULATE


@dataclass(frozen=True)
class FreeRunFails(Reason):
    """The free simulations of these ``logs`` fail, the first for this ``failure``."""

    logs: tuple[str, ...]
    failure: Failure


@dataclass(frozen=True)
class FreeRunAstray(Reason):
    """The free simulation of a ``log`` has a large ``error`` (% of the motion of a ``joint``).

    With the measured torque as ``driver`` it is restarted every ``restart`` s.
    """

    log: str
    joint: str
    error: float
    driver: Driver
    restart: float | None

    @property
    def remedy(self) -> Remedy | None:
        """Closed-loop simulation where the torque alone drove the arm, which drifts; else no single remedy."""
        return None if self.driver is Driver.CONTROLLER else Remedy.CONTROLLER_LOOP
