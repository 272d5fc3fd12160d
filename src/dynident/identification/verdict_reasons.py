"""The reasons of a verdict against more use of a model."""

from __future__ import annotations

from typing import ClassVar

from dynident.identification.verdict_steps import HoldOutFaster, NextStep, Remedy
from dynident.models.simulation import Failure
from dynident.runtime import Finding, Statement, TaggedUnion, join_names, percent, place_and_text, rough, short
from dynident.validation import Driver, FloorOrigin, NoiseFloor

MAX_NAMES = 5  # names of negative parameters that a sentence lists


class Reason(Statement, TaggedUnion):
    """Base of the reasons; errors are in %. The ``sentence`` is a format of the fields."""

    usual_remedy: ClassVar[Remedy | None] = None
    sentence: ClassVar[str] = ""

    def __str__(self) -> str:
        return self.sentence.format(**vars(self))

    @property
    def remedy(self) -> Remedy | NextStep | None:
        """What to do about it, None where there is no single remedy."""
        return self.usual_remedy


class NoHoldOut(Reason):
    """No log was held out."""

    usual_remedy = Remedy.HOLD_OUT
    sentence = "no log was held out, so the error on unseen motion is not known"


class ForbiddingFindings(Reason):
    """Findings of the checks, or notes of the estimate, that forbid a use: ``findings`` of one kind."""

    usual_remedy = Remedy.CORRECT
    findings: tuple[Finding, ...]

    def __str__(self) -> str:
        return ": ".join(filter(None, place_and_text(self.findings))).removesuffix(".")


class Repeats(Reason):
    """All held-out logs repeat a motion of the training: ``pairs`` of their names."""

    usual_remedy = Remedy.ANOTHER_MOTION
    pairs: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        repeats = ", ".join(f"{name} repeats the motion of {original}" for name, original in self.pairs)
        return f"{repeats}: the error on another motion is not known"


class SlowHoldOut(Reason):
    """The held-out motions have at most ``share`` of the speed of the training, so that little is seen of inertia."""

    share: float

    @property
    def remedy(self) -> NextStep | None:
        """A motion as fast as the training; any other where the held-out one does not move."""
        return HoldOutFaster(1.0 / self.share) if self.share > 0 else None

    def __str__(self) -> str:
        return f"the held-out motion reaches only {rough(100 * self.share)} of the training speed"


class SilentTorque(Reason):
    """The torque of these ``joints`` does not change in any training log."""

    usual_remedy = Remedy.TORQUE_COLUMN
    joints: tuple[str, ...]

    def __str__(self) -> str:
        return f"the torque of {', '.join(self.joints)} does not change in any training log"


class TorqueErrorTooLarge(Reason):
    """The torque ``error`` on a held-out ``log`` exceeds the ``limit``."""

    usual_remedy = Remedy.CHECK
    log: str
    error: float
    limit: float

    def __str__(self) -> str:
        return f"the torque error on {self.log} is {percent(self.error)}, above {self.limit:g} %"


class UnfilteredErrorTooLarge(TorqueErrorTooLarge):
    """A torque error of the unfiltered torque that is too large, where the fit has a low-pass."""

    def __str__(self) -> str:
        return f"unfiltered, {super().__str__()}"


class JointErrorsTooLarge(Reason):
    """Single joints have a torque error above the ``limit``: pairs of name and error."""

    usual_remedy = Remedy.LONGER_TRAINING
    log: str
    errors: tuple[tuple[str, float], ...]
    limit: float

    def __str__(self) -> str:
        bad = ", ".join(f"{joint} {percent(size)}" for joint, size in self.errors)
        return f"on {self.log} some joints have a torque error above {self.limit:g} %: {bad}"


class WeakJoints(Reason):
    """Joints that hardly exert torque on a ``log`` have a large relative error: names, error (%) and rms (N m, N)."""

    log: str
    joints: tuple[tuple[str, float, float], ...]

    def __str__(self) -> str:
        joints = join_names(
            (f"{joint} ({percent(error)}, rms {short(rms, 2)} N m or N)" for joint, error, rms in self.joints),
            MAX_NAMES,
        )
        return f"not for estimating forces where torques are as small as on {self.log}: {joints}"


class NotCarriedOver(Reason):
    """The error on a held-out ``log`` is ``ratio`` times that of the training."""

    usual_remedy = Remedy.LONGER_TRAINING
    sentence = "the error on {log} is {ratio:.2g} times the training error: the model does not generalise"
    log: str
    ratio: float


class AboveFloor(Reason):
    """The torques of some ``joints`` are predicted on a ``log`` far worse than the noise of the sensors allows."""

    usual_remedy = Remedy.CHECK
    log: str
    joints: tuple[tuple[str, NoiseFloor], ...]

    def __str__(self) -> str:
        joints = join_names((f"{joint} {floor.ratio:.2g} times" for joint, floor in self.joints), MAX_NAMES)
        is_white = self.joints[0][1].origin is FloorOrigin.WHITE
        noise = "white noise of the sensors" if is_white else "scatter between repeated motions"
        return f"on {self.log}, residuals exceed the {noise} ({joints}): the model lacks an effect, or a value is wrong"


class TrainedWorse(Reason):
    """The ``error`` on a training ``log`` is large, ``ratio`` times that held out: the fit has outliers, or a fault."""

    usual_remedy = Remedy.CHECK
    log: str
    error: float
    ratio: float

    def __str__(self) -> str:
        error = f"the error on the training log {self.log} is {percent(self.error)}"
        return f"{error}, {self.ratio:.2g} times the held-out error: the training data contain outliers or a fault"


class MassMatrixNotPositive(Reason):
    """The mass matrix has an ``eigenvalue`` that is not positive."""

    usual_remedy = Remedy.CONSISTENT_FIT
    sentence = "the mass matrix is not positive definite (eigenvalue {eigenvalue:.3g})"
    eigenvalue: float


class MostlyUnexcited(Reason):
    """The data do not excite so many of the ``total`` base parameters that the model is of no use."""

    usual_remedy: ClassVar[Remedy | None] = Remedy.EXCITE
    sentence = "the data do not excite {unexcited} of {total} base parameters"
    unexcited: int
    total: int


class PartlyUnexcited(MostlyUnexcited):
    """The data do not excite some of the ``total`` base parameters; motions that do are not predicted."""

    usual_remedy = None
    sentence = "{unexcited} of {total} base parameters are not excited: where a motion excites them, torque is unknown"


class Uncertain(Reason):
    """By its own standard errors the torque has an ``error`` (%) on the training motion at twice its speed and size."""

    usual_remedy = Remedy.EXCITE
    error: float

    def __str__(self) -> str:
        motion = "at twice the speed and size of the training motion"
        return f"{motion} the torque has a standard error of {rough(self.error)}: the training excites too little"


class HeldBack(Reason):
    """Physical constraints hold the parameters far from the least-squares estimate.

    Without them the residual would be smaller: it is ``growth`` % larger. On the training motion at twice its
    speed the torque would differ by ``torque_change`` %.
    """

    usual_remedy = Remedy.CHECK
    cause: ClassVar[str] = "physical constraints keep"
    doubt: ClassVar[str] = "the model lacks an effect, or a gain, a unit or a direction is wrong"
    growth: float
    torque_change: float

    def __str__(self) -> str:
        smaller = rough(100 - 100 / (1 + self.growth / 100))
        return (
            f"{self.cause} the parameters far from the least-squares fit, whose residual is {smaller} smaller and "
            f"whose torque at twice the speed differs by {rough(self.torque_change)}: {self.doubt}"
        )


class DrawnBack(HeldBack):
    """A prior, without any constraint, holds the parameters far from the least-squares estimate."""

    cause = "the prior keeps"
    doubt = "the prior is wrong or too strong, or the model lacks an effect"


class NegativeValues(Reason):
    """Parameters with ``names`` are negative, which is not physical."""

    usual_remedy = Remedy.CONSISTENT_FIT
    names: tuple[str, ...]

    def __str__(self) -> str:
        return f"these parameters are negative, which is not physical: {join_names(self.names, MAX_NAMES)}"


class InertiasFree(Reason):
    """The bodies' inertias were not constrained to be physically consistent."""

    usual_remedy = Remedy.CONSISTENT_FIT
    sentence = "the bodies' inertias were not constrained to be physically consistent"


class NoFreeRun(Reason):
    """No free simulation was asked for."""

    usual_remedy = Remedy.SIMULATE
    sentence = "no free simulation was run"


class FreeRunFails(Reason):
    """The free simulations of these ``logs`` fail, the first for this ``failure``."""

    logs: tuple[str, ...]
    failure: Failure

    def __str__(self) -> str:
        return f"the free simulation of {', '.join(self.logs)} fails: {self.failure}"


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

    def __str__(self) -> str:
        looped = self.driver is Driver.CONTROLLER
        way = "in the controller's loop" if looped else f"within {self.restart:g} s of the measured torque"
        error = f"{rough(self.error)} of the motion of {self.joint}"
        return f"the free simulation of {self.log} has an error of {error} {way}"
