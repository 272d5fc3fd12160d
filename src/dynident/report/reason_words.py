"""The words for the reasons against the use of a model."""

from __future__ import annotations

from dynident.identification.verdict import reasons
from dynident.report.check import finding_row
from dynident.report.wording import words
from dynident.report.words import percent, rough
from dynident.validation import Driver

MOST = 5  # names of negative parameters


@words.register
def _(reason: reasons.NoHoldOut) -> str:  # noqa: ARG001
    return "no log was held out, so the error on unseen motion is not known"


@words.register
def _(reason: reasons.Noted) -> str:
    return ": ".join(filter(None, finding_row(reason.findings))).removesuffix(".")


@words.register
def _(reason: reasons.Repeats) -> str:
    repeats = ", ".join(f"{name} repeats the motion of {other}" for name, other in reason.pairs)
    return f"{repeats}: the error on another motion is not known"


@words.register
def _(reason: reasons.SlowHoldOut) -> str:
    return f"the held-out motion has only {rough(100 * reason.share)} of the speed of the training"


@words.register
def _(reason: reasons.SilentTorque) -> str:
    return f"the torque of {', '.join(reason.joints)} does not change in any training log"


@words.register
def _(reason: reasons.TorqueErrorTooLarge) -> str:
    return f"the torque error on {reason.log} is {percent(reason.error)}, above {reason.limit:g} %"


@words.register
def _(reason: reasons.UnfilteredErrorTooLarge) -> str:
    return f"unfiltered, the torque error on {reason.log} is {percent(reason.error)}, above {reason.limit:g} %"


@words.register
def _(reason: reasons.JointErrorsTooLarge) -> str:
    bad = ", ".join(f"{joint} {percent(size)}" for joint, size in reason.errors)
    return f"on {reason.log} some joints have a torque error above {reason.limit:g} %: {bad}"


@words.register
def _(reason: reasons.NotCarriedOver) -> str:
    return f"the error on {reason.log} is {reason.ratio:.2g} times the training error: the model does not generalise"


@words.register
def _(reason: reasons.TrainedWorse) -> str:
    return (
        f"the error on {reason.log}, which was fitted, is {percent(reason.error)}, {reason.ratio:.2g} times the "
        "held-out error: outliers or a fault are in the fit"
    )


@words.register
def _(reason: reasons.MassMatrixNotPositive) -> str:
    return f"the mass matrix is not positive definite (eigenvalue {reason.eigenvalue:.3g})"


@words.register
def _(reason: reasons.MostlyUnexcited) -> str:
    return f"the data do not excite {reason.unexcited} of {reason.total} base parameters"


@words.register
def _(reason: reasons.PartlyUnexcited) -> str:
    left = f"{reason.unexcited} of {reason.total} base parameters"
    return f"the data do not excite {left}: motions that do are not predicted"


@words.register
def _(reason: reasons.DrawnBack) -> str:
    return (
        "the prior holds the parameters far from what the data say (without it the residual would be "
        f"{rough(100 - 100 / (1 + reason.growth / 100))} smaller, and the torque at twice the speed would differ by "
        f"{rough(reason.apart)}): the prior is wrong or too strong, or the model lacks an effect"
    )


@words.register
def _(reason: reasons.HeldBack) -> str:
    return (
        "physical constraints hold the parameters far from what the data say (without them the residual would be "
        f"{rough(100 - 100 / (1 + reason.growth / 100))} smaller, and the torque at twice the speed would differ by "
        f"{rough(reason.apart)}): the model lacks an effect, or a gain, a unit or a direction is wrong"
    )


@words.register
def _(reason: reasons.NegativeValues) -> str:
    more = f" and {len(reason.names) - MOST} more" if len(reason.names) > MOST else ""
    return f"negative values, which are not physical: {', '.join(reason.names[:MOST])}{more}"


@words.register
def _(reason: reasons.InertiasFree) -> str:  # noqa: ARG001
    return "the bodies' inertias were not constrained to be physically consistent"


@words.register
def _(reason: reasons.NoFreeRun) -> str:  # noqa: ARG001
    return "no free simulation was run"


@words.register
def _(reason: reasons.FreeRunFails) -> str:
    return f"the free simulation of {', '.join(reason.logs)} fails: {words(reason.failure)}"


@words.register
def _(reason: reasons.FreeRunAstray) -> str:
    looped = reason.driver is Driver.CONTROLLER
    way = "in the controller's loop" if looped else f"within {reason.restart:g} s of the measured torque"
    error = f"{rough(reason.error)} of the motion of {reason.joint}"
    return f"the free simulation of {reason.log} has an error of {error} {way}"
