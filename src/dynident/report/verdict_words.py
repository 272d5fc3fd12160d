"""The text of the verdict: its three sentences, and what to do next."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.identification import Remedy, verdict, verdict_steps
from dynident.identification.verdict import CommonGain, MotionRatios, Zeros
from dynident.regression import UnexcitedParameters
from dynident.report import verdict_words  # noqa: F401  # registers its words
from dynident.report.check import finding_row
from dynident.report.note_words import causes_words, words
from dynident.report.page import number
from dynident.report.robot_words import remedy
from dynident.report.words import percent, rough, shorten
from dynident.runtime import Use
from dynident.validation import AT_FLOOR, Driver, FloorOrigin

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dynident.identification import HeldOut, Verdict
    from dynident.validation import NoiseFloor

MAX_NAMES = 5  # names of negative parameters
NAMED_REASONS = 2  # reasons that the second sentence names
MIN_REPORTED_GAIN = 0.01  # points: smaller gains are not given

_USE_SENTENCES = {
    Use.DO_NOT_USE: "Do not use this model yet",
    Use.CONTROL: "Good for control (feedforward, gravity compensation) on motions like these",
    Use.SIMULATION: "Good for simulation and control on motions like these",
}
_REMEDIES = {
    Remedy.CORRECT: "Correct what was found, as the reasons say, and identify again.",
    Remedy.HOLD_OUT: (
        "Record another motion and name it under `validation`; windows of one recording are enough for a first check."
    ),
    Remedy.ANOTHER_MOTION: (
        "Record a held-out motion with other paths and speeds; a repeated motion only shows the robot's repeatability."
    ),
    Remedy.CHECK: (
        "Run `dynident check` on the configuration: it checks signs, gains, units and gravity. Then look at the "
        "largest residuals in the report; other friction terms or less noise in the motion may help."
    ),
    Remedy.TORQUE_COLUMN: "Check that the right torque column is named, and was recorded.",
    Remedy.LONGER_TRAINING: (
        "Record a longer training motion that covers the speeds and accelerations of the held-out one."
    ),
    Remedy.EXCITE: (
        "Record a training motion in which every joint moves: at several speeds, and in many poses of the others."
    ),
    Remedy.CONSISTENT_FIT: (
        "Fit with `estimator: {kind: consistent}`: bodies and friction are then physically consistent, and the mass "
        "matrix is positive definite."
    ),
    Remedy.SIMULATE: (
        "Add `simulation:` to the configuration, with the controller where it is known, else `kind: measured_torque`."
    ),
    Remedy.CONTROLLER_LOOP: (
        "Simulate in closed loop with the controller, where it is known: driven by torque alone, any model drifts."
    ),
}
_EXCITATIONS = {
    verdict_steps.ExcitingMotion.CONSTANT_SPEEDS: "move {joint} at several constant speeds in both directions",
    verdict_steps.ExcitingMotion.MANY_POSES: "move {joint} slowly to and fro in many poses",
    verdict_steps.ExcitingMotion.ACCELERATE: "accelerate {joint} harder, in several poses of the others",
}
_PROGRAM_OPTIONS = {  # by the program that designs such a motion
    "": (verdict_steps.Sharpen, verdict_steps.Cover, UnexcitedParameters),
    " --program friction": (verdict_steps.SlowReversals, verdict_steps.CheckRipple),
}
_MOTION_REMEDIES = (Remedy.EXCITE, Remedy.LONGER_TRAINING, Remedy.ANOTHER_MOTION)


@words.register
def _(reason: verdict.NoHoldOut) -> str:  # noqa: ARG001
    return "no log was held out, so the error on unseen motion is not known"


@words.register
def _(reason: verdict.ForbiddingFindings) -> str:
    return ": ".join(filter(None, finding_row(reason.findings))).removesuffix(".")


@words.register
def _(reason: verdict.Repeats) -> str:
    repeats = ", ".join(f"{name} repeats the motion of {original}" for name, original in reason.pairs)
    return f"{repeats}: the error on another motion is not known"


@words.register
def _(reason: verdict.SlowHoldOut) -> str:
    return f"the held-out motion has only {rough(100 * reason.share)} of the speed of the training"


@words.register
def _(reason: verdict.SilentTorque) -> str:
    return f"the torque of {', '.join(reason.joints)} does not change in any training log"


@words.register
def _(reason: verdict.TorqueErrorTooLarge) -> str:
    return f"the torque error on {reason.log} is {percent(reason.error)}, above {reason.limit:g} %"


@words.register
def _(reason: verdict.UnfilteredErrorTooLarge) -> str:
    return f"unfiltered, the torque error on {reason.log} is {percent(reason.error)}, above {reason.limit:g} %"


@words.register
def _(reason: verdict.JointErrorsTooLarge) -> str:
    bad = ", ".join(f"{joint} {percent(size)}" for joint, size in reason.errors)
    return f"on {reason.log} some joints have a torque error above {reason.limit:g} %: {bad}"


@words.register
def _(reason: verdict.NotCarriedOver) -> str:
    return f"the error on {reason.log} is {reason.ratio:.2g} times the training error: the model does not generalise"


@words.register
def _(reason: verdict.TrainedWorse) -> str:
    return (
        f"the error on {reason.log}, which was fitted, is {percent(reason.error)}, {reason.ratio:.2g} times the "
        "held-out error: outliers or a fault are in the fit"
    )


@words.register
def _(reason: verdict.MassMatrixNotPositive) -> str:
    return f"the mass matrix is not positive definite (eigenvalue {reason.eigenvalue:.3g})"


@words.register
def _(reason: verdict.MostlyUnexcited) -> str:
    return f"the data do not excite {reason.unexcited} of {reason.total} base parameters"


@words.register
def _(reason: verdict.PartlyUnexcited) -> str:
    unexcited = f"{reason.unexcited} of {reason.total} base parameters"
    return f"the data do not excite {unexcited}: motions that do are not predicted"


@words.register
def _(reason: verdict.DrawnBack) -> str:
    return (
        "the prior holds the parameters far from what the data say (without it the residual would be "
        f"{rough(100 - 100 / (1 + reason.growth / 100))} smaller, and the torque at twice the speed would differ by "
        f"{rough(reason.torque_change)}): the prior is wrong or too strong, or the model lacks an effect"
    )


@words.register
def _(reason: verdict.HeldBack) -> str:
    return (
        "physical constraints hold the parameters far from what the data say (without them the residual would be "
        f"{rough(100 - 100 / (1 + reason.growth / 100))} smaller, and the torque at twice the speed would differ by "
        f"{rough(reason.torque_change)}): the model lacks an effect, or a gain, a unit or a direction is wrong"
    )


@words.register
def _(reason: verdict.NegativeValues) -> str:
    suffix = f" and {len(reason.names) - MAX_NAMES} more" if len(reason.names) > MAX_NAMES else ""
    return f"negative values, which are not physical: {', '.join(reason.names[:MAX_NAMES])}{suffix}"


@words.register
def _(reason: verdict.InertiasFree) -> str:  # noqa: ARG001
    return "the bodies' inertias were not constrained to be physically consistent"


@words.register
def _(reason: verdict.NoFreeRun) -> str:  # noqa: ARG001
    return "no free simulation was run"


@words.register
def _(reason: verdict.FreeRunFails) -> str:
    return f"the free simulation of {', '.join(reason.logs)} fails: {words(reason.failure)}"


@words.register
def _(reason: verdict.FreeRunAstray) -> str:
    looped = reason.driver is Driver.CONTROLLER
    way = "in the controller's loop" if looped else f"within {reason.restart:g} s of the measured torque"
    error = f"{rough(reason.error)} of the motion of {reason.joint}"
    return f"the free simulation of {reason.log} has an error of {error} {way}"


def design_options(step: object) -> str | None:
    """Return the options of ``dynident excite`` that design the motion a step asks for, None for other steps."""
    if step in _MOTION_REMEDIES:
        return ""
    return next((options for options, kinds in _PROGRAM_OPTIONS.items() if isinstance(step, kinds)), None)


def verdict_sentences(verdict: Verdict, max_length: int | None = None) -> tuple[str, ...]:
    """Return the verdict in sentences: use and errors, reasons against more use, residual, what stays unknown.

    Reasons of more than ``max_length`` characters are cut.
    """
    opening = f"{_USE_SENTENCES[verdict.use]}: {_error_clause(verdict.held_out)}."
    return opening, _reasons_sentence(verdict, max_length), _residual_sentence(verdict), *_unknown_sentence(verdict)


def _unknown_sentence(verdict: Verdict) -> tuple[str, ...]:
    unknowns = [words(unknown) for unknown in verdict.unknown]
    return (f"No data can show {', or '.join(unknowns)}: make sure of that by other means.",) if unknowns else ()


def _error_clause(errors: HeldOut | None) -> str:
    if errors is None:
        return "no log was held out"
    if errors.unfiltered is None:
        return (
            f"on held-out motion it leaves {percent(errors.error)} of the torque unexplained, "
            f"in training {percent(errors.training)}"
        )
    measured, trained = errors.unfiltered
    return (
        f"on held-out motion it leaves {percent(errors.error)} of the torque unexplained after the low-pass of the fit "
        f"(training {percent(errors.training)}), and {percent(measured)} of it as measured ({percent(trained)})"
    )


def _reasons_sentence(verdict: Verdict, max_length: int | None) -> str:
    reasons, run = verdict.reasons, verdict.run
    if not reasons and run is not None:
        return (
            "Its mass matrix is positive definite in all poses tested, and the error of its free simulation is at "
            f"most {rough(run.error)} of the motion ({run.joint}, {run.log})."
        )
    clauses = [shorten(words(reason), max_length) for reason in reasons[:NAMED_REASONS]]
    clauses += [f"and {len(reasons) - NAMED_REASONS} more"] if len(reasons) > NAMED_REASONS else []
    opening = "Against its use" if verdict.use is Use.DO_NOT_USE else "Not for simulation"
    return f"{opening}: {_join_reasons(clauses)}"


def _join_reasons(reasons: Sequence[str]) -> str:
    """Join reasons into one sentence, or into several where one of them ends with a question."""
    text = ""
    for reason in reasons:
        # A reason that ends with a question mark closes its sentence, so the next one begins another
        text += f" And {reason.removeprefix('and ')}" if text.endswith("?") else f"; {reason}" if text else reason
    return text if text.endswith("?") else f"{text}."


def _residual_sentence(verdict: Verdict) -> str:
    worst = verdict.residual
    if worst is None:
        return "The torque residual could not be tested."
    if worst.all_at_floor and worst.over is not None:
        return (
            f"The torque residual is at the noise floor: on {worst.log} it is {worst.over:.2f} times what the sensors "
            f"allow, and at each joint at most {AT_FLOOR:g} times with 95 % confidence."
        )
    where = f"The torque residual is largest in {worst.joint} ({worst.log})"
    if worst.floor is not None and worst.floor.is_reached:
        return f"{where}, where it is at the noise floor, {worst.floor.ratio:.2f} times what the sensors allow."
    points = f"points to {causes_words(worst.causes, worst.floor)}" if worst.causes else "has no clear cause"
    return f"{where}{_floor_clause(worst.floor)} and {points}."


def _floor_clause(floor: NoiseFloor | None) -> str:
    if floor is None:
        return ""
    noise = "white noise of the sensors allows" if floor.origin is FloorOrigin.WHITE else "the sensors allow"
    return f", {number(floor.ratio, 2)} times what {noise},"


@words.register
def _(unknown: CommonGain) -> str:  # noqa: ARG001
    return "a factor that all torques share (wrong gains), which masses and friction take up"


@words.register
def _(unknown: Zeros) -> str:
    return f"a wrong zero of {', '.join(unknown.joints)}"


@words.register
def _(unknown: MotionRatios) -> str:
    return f"a wrong gear ratio, lead or unit of the position of {', '.join(unknown.joints)}"


@words.register
def _(remedy: Remedy) -> str:
    return _REMEDIES[remedy]


@words.register
def _(step: verdict_steps.Sharpen) -> str:
    motion = _EXCITATIONS[step.excitation].format(joint=step.joint or "the joints")
    return (
        f"{step.parameter} is {step.value:.3g} +- {step.std:.2g} (one standard error, {rough(step.share)} of the "
        f"torque): {motion}{_speed_clause(step)}.{_gain_text(step, 'at most')}"
    )


def _speed_clause(step: verdict_steps.Sharpen) -> str:
    return f", up to {step.faster:.2g} times the speed" if step.faster is not None and step.faster > 1.05 else ""


def _gain_text(step: verdict_steps.NextStep, how: str = "about") -> str:
    """Return what a step may gain as a sentence, an empty text where that is unknown."""
    if step.gain is None:
        return ""
    size = f"{how} {step.gain:.2g}" if step.gain >= MIN_REPORTED_GAIN else f"less than {MIN_REPORTED_GAIN:g}"
    return f" May gain {size} points of the torque error."


@words.register
def _(step: verdict_steps.SlowReversals) -> str:
    below = f" (below {', '.join(f'{speed:.2g}' for speed in step.speeds)} rad/s or m/s)" if step.speeds else ""
    alternative = "" if step.terms_chosen else ", or try `coulomb_width` or `min_speed`"
    advice = f"{', '.join(step.joints)}: record slow motion through zero speed{alternative}"
    return f"{advice}{below}." + _gain_text(step, "at most")


@words.register
def _(step: verdict_steps.CheckRipple) -> str:
    advice = f"{', '.join(step.joints)}: record constant speeds to see whether the ripple follows the position."
    return advice + _gain_text(step, "at most")


@words.register
def _(step: verdict_steps.SetRight) -> str:
    finding = step.finding
    where = ": ".join(filter(None, (finding.source, finding.joint)))
    return f"{where}: {remedy(finding.message)}".removeprefix(": ") + _gain_text(step)


@words.register
def _(step: verdict_steps.HoldOutFaster) -> str:
    return (
        f"Record a held-out motion {step.times:.2g} times as fast, on other paths: little is seen of the inertias in a "
        "slow one."
    )


@words.register
def _(step: verdict_steps.LeaveOut) -> str:
    return (
        f"{step.log}: leave {_stretch(step)} out of the training (`window`): predicted from the rest, their squared "
        f"residual is {step.ratio:.2g} times that of the rest. Did the robot touch something there?{_gain_text(step)}"
    )


@words.register
def _(step: verdict_steps.Cover) -> str:
    return (
        f"{step.joint}: record a training motion {step.faster:.2g} times as fast, up to {step.speed:.2g} rad/s or m/s: "
        f"{step.log} is beyond what was trained, above all at {_stretch(step)}.{_gain_text(step)}"
    )


def _stretch(step: verdict_steps.LeaveOut | verdict_steps.Cover) -> str:
    return f"{number(step.start, 3)} to {number(step.stop, 3)} s"
