"""The text of the verdict: its three sentences, and what to do next."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.identification import Remedy, Use
from dynident.identification.verdict import steps
from dynident.identification.verdict.unknown import CommonGain, Ratios, Zeros
from dynident.regression import UnexcitedParameters
from dynident.report import reason_words  # noqa: F401  # registers its words
from dynident.report.page import number
from dynident.report.robot_words import remedy
from dynident.report.wording import causes_words, words
from dynident.report.words import cut, percent, rough
from dynident.validation import AT_FLOOR, FloorOrigin

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dynident.identification import HeldOut, Verdict
    from dynident.validation import NoiseFloor

__all__ = ["IN_SENTENCES", "designed", "sentences"]

IN_SENTENCES = 2  # reasons that the second sentence names
SMALL = 0.01  # points: smaller gains are not given

_FIRST = {
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
    steps.ExcitingMotion.CONSTANT_SPEEDS: "move {joint} at several constant speeds in both directions",
    steps.ExcitingMotion.MANY_POSES: "move {joint} slowly to and fro in many poses",
    steps.ExcitingMotion.ACCELERATE: "accelerate {joint} harder, in several poses of the others",
}
_DESIGNED = {  # by the program that designs such a motion
    "": (steps.Sharpen, steps.Cover, UnexcitedParameters),
    " --program friction": (steps.SlowReversals, steps.CheckRipple),
}
_ASKED = (Remedy.EXCITE, Remedy.LONGER_TRAINING, Remedy.ANOTHER_MOTION)


def designed(step: object) -> str | None:
    """Return the options of ``dynident excite`` with which it designs the motion of a next step; None for another."""
    if step in _ASKED:
        return ""
    return next((options for options, kinds in _DESIGNED.items() if isinstance(step, kinds)), None)


def sentences(verdict: Verdict, longest: int | None = None) -> tuple[str, ...]:
    """Return the verdict in sentences: the use and the errors, the reasons against more, the residual, the unknown.

    Reasons are cut where they have more than the ``longest`` number of signs.
    """
    first = f"{_FIRST[verdict.use]}: {_errors(verdict.held_out)}."
    return first, _against(verdict, longest), _left(verdict), *_unknown(verdict)


def _unknown(verdict: Verdict) -> tuple[str, ...]:
    given = [words(one) for one in verdict.unknown]
    return (f"No data can show {', or '.join(given)}: make sure of that by other means.",) if given else ()


def _errors(held: HeldOut | None) -> str:
    if held is None:
        return "no log was held out"
    if held.unfiltered is None:
        return (
            f"on held-out motion it leaves {percent(held.error)} of the torque unexplained, "
            f"in training {percent(held.training)}"
        )
    measured, trained = held.unfiltered
    return (
        f"on held-out motion it leaves {percent(held.error)} of the torque unexplained after the low-pass of the fit "
        f"(training {percent(held.training)}), and {percent(measured)} of it as measured ({percent(trained)})"
    )


def _against(verdict: Verdict, longest: int | None) -> str:
    given, run = verdict.reasons, verdict.run
    if not given and run is not None:
        return (
            "Its mass matrix is positive definite in all poses tested, and the error of its free simulation is at "
            f"most {rough(run.error)} of the motion ({run.joint}, {run.log})."
        )
    named = [cut(words(one), longest) for one in given[:IN_SENTENCES]]
    named += [f"and {len(given) - IN_SENTENCES} more"] if len(given) > IN_SENTENCES else []
    what = "Against its use" if verdict.use is Use.DO_NOT_USE else "Not for simulation"
    return f"{what}: {_joined(named)}"


def _joined(named: Sequence[str]) -> str:
    """Return reasons as a sentence, or as several where one of them ends with a question."""
    text = ""
    for one in named:
        text += f" And {one.removeprefix('and ')}" if text.endswith("?") else f"; {one}" if text else one
    return text if text.endswith("?") else f"{text}."


def _left(verdict: Verdict) -> str:
    left = verdict.residual
    if left is None:
        return "The torque residual could not be tested."
    if left.all_at_floor and left.over is not None:
        return (
            f"The torque residual is at the noise floor: on {left.log} it is {left.over:.2f} times what the sensors "
            f"allow, and at each joint at most {AT_FLOOR:g} times with 95 % confidence."
        )
    where = f"The torque residual is largest in {left.joint} ({left.log})"
    if left.floor is not None and left.floor.reached:
        return f"{where}, where it is at the noise floor, {left.floor.ratio:.2f} times what the sensors allow."
    points = f"points to {causes_words(left.causes, left.floor)}" if left.causes else "has no clear cause"
    return f"{where}{_above(left.floor)} and {points}."


def _above(floor: NoiseFloor | None) -> str:
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
def _(unknown: Ratios) -> str:
    return f"a wrong gear ratio, lead or unit of the position of {', '.join(unknown.joints)}"


@words.register
def _(remedy: Remedy) -> str:
    return _REMEDIES[remedy]


@words.register
def _(step: steps.Sharpen) -> str:
    motion = _EXCITATIONS[step.excitation].format(joint=step.joint or "the joints")
    return (
        f"{step.parameter} is {step.value:.3g} +- {step.std:.2g} (one standard error, {rough(step.share)} of the "
        f"torque): {motion}{_faster(step)}.{_gain(step, 'at most')}"
    )


def _faster(step: steps.Sharpen) -> str:
    return f", up to {step.faster:.2g} times the speed" if step.faster is not None and step.faster > 1.05 else ""


def _gain(step: steps.Step, how: str = "about") -> str:
    """Return what a step may gain, as a sentence."""
    if step.gain is None:
        return ""
    size = f"{how} {step.gain:.2g}" if step.gain >= SMALL else f"less than {SMALL:g}"
    return f" May gain {size} points of the torque error."


@words.register
def _(step: steps.SlowReversals) -> str:
    below = f" (below {', '.join(f'{speed:.2g}' for speed in step.speeds)} rad/s or m/s)" if step.speeds else ""
    other = "" if step.chosen else ", or try `coulomb_width` or `min_speed`"
    said = f"{', '.join(step.joints)}: record slow motion through zero speed{other}"
    return f"{said}{below}." + _gain(step, "at most")


@words.register
def _(step: steps.CheckRipple) -> str:
    said = f"{', '.join(step.joints)}: record constant speeds to see whether the ripple follows the position."
    return said + _gain(step, "at most")


@words.register
def _(step: steps.SetRight) -> str:
    finding = step.finding
    where = ": ".join(filter(None, (finding.source, finding.joint)))
    return f"{where}: {remedy(finding.message)}".removeprefix(": ") + _gain(step)


@words.register
def _(step: steps.HoldOutFaster) -> str:
    return (
        f"Record a held-out motion {step.times:.2g} times as fast, on other paths: little is seen of the inertias in a "
        "slow one."
    )


@words.register
def _(step: steps.LeaveOut) -> str:
    return (
        f"{step.log}: leave {_seconds(step)} out of the training (`window`): predicted from the rest, their squared "
        f"residual is {step.ratio:.2g} times that of the rest. Did the robot touch something there?{_gain(step)}"
    )


@words.register
def _(step: steps.Cover) -> str:
    return (
        f"{step.joint}: record a training motion {step.faster:.2g} times as fast, up to {step.speed:.2g} rad/s or m/s: "
        f"{step.log} is beyond what was trained, above all at {_seconds(step)}.{_gain(step)}"
    )


def _seconds(step: steps.LeaveOut | steps.Cover) -> str:
    return f"{number(step.start, 3)} to {number(step.stop, 3)} s"
