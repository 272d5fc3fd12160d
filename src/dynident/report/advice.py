"""The verdict in words: its three sentences, the reasons against a use, and what to do next."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.identification import Remedy, Use
from dynident.identification.verdict import reasons, steps
from dynident.report.wording import words
from dynident.validation import Driver

if TYPE_CHECKING:
    from dynident.identification import HeldOut, Verdict

__all__ = ["IN_SENTENCES", "sentences"]

IN_SENTENCES = 2  # reasons that the second sentence names
MOST = 5  # names of negative parameters

_FIRST = {
    Use.DO_NOT_USE: "Do not use this model yet",
    Use.CONTROL: "Good for control (feedforward, gravity compensation) on motions like these",
    Use.SIMULATION: "Good for simulation and control on motions like these",
}
_REMEDIES = {
    Remedy.HOLD_OUT: (
        "Record another motion and name it under `validation`; windows of one recording do for a first look."
    ),
    Remedy.ANOTHER_MOTION: (
        "Record a motion of other paths and speeds to hold out; a repeat only shows how repeatable the robot is."
    ),
    Remedy.CHECK: (
        "Run `dynident check` on the configuration: it asks about signs, gains, units and gravity. Then look at the "
        "residuals of the largest joints below; other friction terms or less noise in the motion may help."
    ),
    Remedy.TORQUE_COLUMN: "Look whether the right torque column is named, and was recorded.",
    Remedy.LONGER_TRAINING: (
        "Record a longer training motion that covers the speeds and accelerations of the held-out one."
    ),
    Remedy.CONSISTENT_FIT: (
        "Fit with `estimator: {kind: consistent}`: bodies and friction are then possible, the mass matrix positive."
    ),
    Remedy.SIMULATE: (
        "Add `simulation:` to the configuration: the controller where it is known, else `kind: measured_torque`."
    ),
    Remedy.CONTROLLER_LOOP: (
        "Simulate in the loop of the controller, where it is known: an arm driven by torque alone drifts for any model."
    ),
}
_EXCITATIONS = {
    steps.Excitation.CONSTANT_SPEEDS: "move {joint} at several constant speeds in both directions",
    steps.Excitation.MANY_POSES: "hold {joint} still or move it slowly in many poses",
    steps.Excitation.ACCELERATE: "accelerate {joint} harder, in several poses of the others",
}


def sentences(verdict: Verdict) -> tuple[str, str, str]:
    """Return the verdict in three sentences: the use and the errors, what stands against more, what is left."""
    return f"{_FIRST[verdict.use]}: {_errors(verdict.held_out)}.", _against(verdict), _left(verdict)


def _errors(held: HeldOut | None) -> str:
    if held is None:
        return "no log was held out"
    if held.unfiltered is None:
        return (
            f"on held-out motion it leaves {held.error:.3g} % of the torque unexplained, "
            f"in training {held.training:.3g} %"
        )
    measured, trained = held.unfiltered
    return (
        f"on held-out motion it leaves {held.error:.3g} % of the torque unexplained after the low-pass of the fit "
        f"(training {held.training:.3g} %), and {measured:.3g} % of it as measured ({trained:.3g} %)"
    )


def _against(verdict: Verdict) -> str:
    given, run = verdict.reasons, verdict.run
    if not given and run is not None:
        return (
            "Its mass matrix is positive definite in all poses tried, and its free simulation is off by at "
            f"most {_percent(run.error)} of the way ({run.joint}, {run.log})."
        )
    more = f"; and {len(given) - IN_SENTENCES} more" if len(given) > IN_SENTENCES else ""
    what = "Against its use" if verdict.use is Use.DO_NOT_USE else "Not for simulation"
    return f"{what}: {'; '.join(map(words, given[:IN_SENTENCES]))}{more}."


def _left(verdict: Verdict) -> str:
    left = verdict.residual
    if left is None:
        return "Nothing can be said of what is left of the torque."
    points = f"points to {' and '.join(map(words, left.causes))}" if left.causes else "has no single cause"
    return f"What is left of the torque is largest in {left.joint} ({left.log}) and {points}."


@words.register
def _(remedy: Remedy) -> str:
    return _REMEDIES[remedy]


@words.register
def _(step: steps.Sharpen) -> str:
    motion = _EXCITATIONS[step.excitation].format(joint=step.joint or "the joints")
    return (
        f"{step.parameter} is {step.value:.3g} +- {step.std:.2g} (one standard error, {_percent(step.share)} of the "
        f"torque): {motion}."
    )


@words.register
def _(step: steps.SlowReversals) -> str:
    return f"{', '.join(step.joints)}: record slow motion through zero speed, or try `coulomb_width` or `min_speed`."


@words.register
def _(step: steps.CheckRipple) -> str:
    return f"{', '.join(step.joints)}: record constant speeds to see whether the ripple follows the position."


@words.register
def _(reason: reasons.NoHoldOut) -> str:  # noqa: ARG001
    return "no log was held out, so nothing shows how the model does on unseen motion"


@words.register
def _(reason: reasons.Repeats) -> str:
    repeats = ", ".join(f"{name} repeats the motion of {other}" for name, other in reason.pairs)
    return f"{repeats}: nothing shows how the model does on another motion"


@words.register
def _(reason: reasons.SilentTorque) -> str:
    return f"the torque of {', '.join(reason.joints)} is zero in all of the training: nothing shows it"


@words.register
def _(reason: reasons.TorqueErrorTooLarge) -> str:
    return f"the torque error on {reason.log} is {reason.error:.3g} %, above {reason.limit:g} %"


@words.register
def _(reason: reasons.UnfilteredErrorTooLarge) -> str:
    return f"unfiltered, the torque error on {reason.log} is {reason.error:.3g} %, above {reason.limit:g} %"


@words.register
def _(reason: reasons.JointErrorsTooLarge) -> str:
    bad = ", ".join(f"{joint} {size:.3g} %" for joint, size in reason.errors)
    return f"on {reason.log} single joints have a torque error above {reason.limit:g} %: {bad}"


@words.register
def _(reason: reasons.NotCarriedOver) -> str:
    return f"the error on {reason.log} is {reason.ratio:.2g} times that of the training: it does not carry over"


@words.register
def _(reason: reasons.MassMatrixNotPositive) -> str:
    return f"the mass matrix is not positive definite (eigenvalue {reason.eigenvalue:.3g})"


@words.register
def _(reason: reasons.MostlyUnexcited) -> str:
    return f"the data do not show {reason.unexcited} of {reason.total} base parameters"


@words.register
def _(reason: reasons.PartlyUnexcited) -> str:
    return (
        f"the data do not show {reason.unexcited} of {reason.total} base parameters: what excites them is not predicted"
    )


@words.register
def _(reason: reasons.NegativeValues) -> str:
    more = f" and {len(reason.names) - MOST} more" if len(reason.names) > MOST else ""
    return f"negative values that physics forbids: {', '.join(reason.names[:MOST])}{more}"


@words.register
def _(reason: reasons.InertiasFree) -> str:  # noqa: ARG001
    return "the bodies' inertias were not held to what is physically possible"


@words.register
def _(reason: reasons.NoFreeRun) -> str:  # noqa: ARG001
    return "no free simulation was asked for"


@words.register
def _(reason: reasons.FreeRunFails) -> str:
    return f"the free simulation of {', '.join(reason.logs)} fails: {words(reason.failure)}"


@words.register
def _(reason: reasons.FreeRunAstray) -> str:
    looped = reason.driver is Driver.CONTROLLER
    way = "in the controller's loop" if looped else f"within {reason.restart:g} s of the measured torque"
    return f"the free simulation of {reason.log} is off by {_percent(reason.error)} of the way of {reason.joint} {way}"


def _percent(value: float) -> str:
    return f"{value:.2g} %" if value < 10 else f"{value:.0f} %"
