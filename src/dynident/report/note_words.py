"""Text for notes, causes and noise; one small function per type."""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch
from typing import TYPE_CHECKING

from dynident.estimators import notes
from dynident.identification import Measure, Origin
from dynident.models import MassMatrixCheck
from dynident.models.simulation import Broken, RunsAway, Singular
from dynident.regression import UnexcitedParameters
from dynident.report.words import percent, short
from dynident.runtime import Note, Remark, Severity, join_names
from dynident.validation import FloorOrigin, NoiseFloor, SmoothedAway, residuals

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from dynident.estimators import Estimate
    from dynident.validation import LogValidation

PREFIX = {Severity.ERROR: "Error: ", Severity.WARNING: "Warning: ", Severity.INFO: "Note: "}


@dataclass(frozen=True)
class Line:
    """A line of text for a terminal, and its severity."""

    text: str
    severity: Severity = Severity.INFO


@singledispatch
def words(noun: object) -> str:
    """Return the text for an object, without the full stop; a string is returned unchanged."""
    raise TypeError(f"there is no text for {type(noun).__name__}")


@words.register
def _(text: str) -> str:
    return text


def note_lines(messages: Iterable[Note]) -> list[Line]:
    """Return notes as lines for a terminal, each with its severity in front."""
    return [Line(f"{PREFIX[note.severity]}{words(note)}", note.severity) for note in messages]


def status_words(estimate: Estimate) -> str:
    """Return the notes of an estimate as text, "ok" where there are none."""
    return "; ".join(map(words, estimate.notes)) or "ok"


def residual_words(log: LogValidation, joint: str) -> str:
    """Return what the residual of a joint points to: the noise of the sensors alone, its likely causes, or nothing."""
    floor = log.floors.get(joint)
    return "at the noise floor" if floor and floor.is_reached else causes_words(log.residuals[joint].causes, floor)


def causes_words(causes: Sequence[residuals.Cause], floor: NoiseFloor | None = None) -> str:
    """Return the likely causes of a residual, an empty text where there are none.

    What lies above a known noise ``floor`` is not noise of the sensors.
    """
    texts = [words(cause) for cause in causes]
    # Above a white floor, coloured noise is still a possible cause
    if floor is not None:
        coloured = ", or coloured noise" if floor.origin is FloorOrigin.WHITE else ""
        above = f"ripple, elasticity or a time offset{coloured} (mostly above {residuals.LOW_FREQUENCY:g} Hz)"
        texts = [above if isinstance(cause, residuals.HighFrequency) else words(cause) for cause in causes]
    return " and ".join(texts)


@words.register
def _(note: Remark) -> str:
    return note.text


@words.register
def _(note: UnexcitedParameters) -> str:
    how = "" if len(note.joints) == 1 else " at the same time" if note.together else " each by itself"
    still = f" (at rest in these data: {', '.join(note.still)})" if note.still else ""
    return f"{'; '.join(note.groupings)}: not excited by these data; move {', '.join(note.joints)}{how}{still}."


@words.register
def _(note: notes.RankDeficient) -> str:
    parts = [f"rank {note.rank} of {note.parameters}"]
    if note.without_effect:
        listed = ", ".join(note.without_effect)
        parts.append(f"no effect on the torque in these data: {listed} (move the joints that excite them)")
    parts += [
        f"only combinations are identifiable: {', '.join(names)} "
        "(remove or fix all but one, or excite them differently)"
        for names in note.tied
    ]
    return "; ".join(parts)


@words.register
def _(note: notes.NotAlone) -> str:
    return f"not determined individually: {', '.join(note.names)}"


@words.register
def _(note: notes.NotByData) -> str:
    return f"{_parameters_are(note.count)} not determined by the data alone"


@words.register
def _(note: notes.DecidedByPrior) -> str:
    return f"{_parameters_are(note.count)} determined by the prior, not by the data"


@words.register
def _(note: notes.NotIdentifiable) -> str:
    return f"{_parameters_are(note.count)} determined by neither data nor prior"


@words.register
def _(note: notes.HeldByConstraints) -> str:
    listed = ", ".join(f"{name} ({size:.1f})" for name, size in note.moved)
    return (
        "constraints hold these base parameters more than 3 standard errors (in brackets) from least squares: "
        f"{listed}; the model lacks an effect, a sensor or a gain is off, or a limit is wrong. "
        "Their standard errors count this"
    )


@words.register
def _(note: notes.ConstraintsCostly) -> str:
    return (
        f"the constraints, most of all {note.family}, raise the training error to {percent(note.error)}, where without "
        f"them it is {percent(note.free)}; look for a wrong sign, gain or axis, or a term that the model lacks"
    )


@words.register
def _(note: notes.MotionCorrected) -> str:
    return (
        f"smoothing and the noise left in the motion bias least squares, {note.parameter} by "
        f"{short(note.size, 2)} standard "
        "errors; predicted by a second smoothing with noise, this bias was subtracted"
    )


@words.register
def _(note: notes.LimitedByMotion) -> str:
    return (
        f"a longer recording does not help {note.limited} of {note.all} base parameters, {note.parameter} above all: "
        "most of their standard errors is what errors of the smoothed motion leave; positions with less noise help"
    )


@words.register
def _(note: notes.MotionTooNoisy) -> str:
    return (
        f"standard errors are too small: smoothing and the noise left in the motion bias {note.parameter} by about "
        f"{short(note.size, 2)} of them, too much to be corrected; use the estimator maximum_likelihood"
    )


@words.register
def _(note: notes.PriorApproached) -> str:
    return f"the prior was not reached exactly: the barrier method stopped at a duality gap of {note.gap:.1e}"


@words.register
def _(note: notes.NotConverged) -> str:
    hint = f"the likelihood may still increase by a factor of exp({short(note.gain, 2)})"
    return f"not converged after {note.iterations} steps: {hint}"


@words.register
def _(note: notes.Failed) -> str:
    return f"maximum likelihood failed, so this is its least-squares start: {note.reason}"


@words.register
def _(note: notes.NotWhite) -> str:
    return (
        f"the torque residuals are not white (correlation between neighbouring samples {note.correlation:z.2f}): they "
        "are "
        "more than noise, so compare with least squares on held-out motion"
    )


@words.register
def _(note: notes.StillColoured) -> str:
    return (
        f"after whitening, the torque residual of {note.joint} is still correlated over time "
        f"({note.correlation:z.2f}): it is more than autoregressive noise, so compare with least squares on held-out "
        "motion"
    )


@words.register
def _(note: notes.WhiteningCostly) -> str:
    because = (
        "slow noise may do that, and so may what the model lacks: compare with least squares on held-out motion"
        if note.chance
        else "such noise alone does not: it is what the model lacks, so that parameters may be many standard errors "
        "off, and least squares predicts better"
    )
    return (
        f"the fit to whitened rows leaves {short(note.ratio, 3)} times as much of the torque of {note.joint} as least "
        f"squares; {because}"
    )


@words.register
def _(note: notes.ScatterLarger) -> str:
    return (
        "standard errors assume white residuals; from the scatter of the residuals over time, that of "
        f"{note.parameter} "
        f"is {short(note.ratio, 2)} times as large"
    )


@words.register
def _(note: notes.StillMoving) -> str:
    return (
        f"not settled after {note.iterations} steps: the last one moved the parameters by "
        f"{short(note.change, 2)} standard errors"
    )


@words.register
def _(note: notes.Downweighted) -> str:
    listed = ", ".join(f"{name} {percent(100 * share)}" for name, share in note.joints)
    return f"torques that look wrong count less than half: {listed} of them"


@words.register
def _(note: notes.DrawnToPrior) -> str:
    return f"drawn to the prior with a strength of {short(note.strength, 2)}, by cross-validation"


@words.register
def _(note: notes.ErrorsInRegressor) -> str:
    return (
        f"along one direction, above all of {note.parameter}, {percent(note.percent)} of what the motion shows "
        "are its own errors: the estimate there rests on their stated size"
    )


@words.register
def _(note: notes.MovingStart) -> str:
    return f"the recordings do not start from rest (likelihood ratio test, p = {note.p_value:.1e})"


@words.register
def _(note: notes.Averaged) -> str:
    return f"each {note.group} neighbouring samples were averaged"


@words.register
def _(note: notes.SmoothSigns) -> str:
    listed = ", ".join(f"{short(x, 2)}" for x in note.widths)
    return f"the sign of the velocity in friction was replaced by tanh(dq / width), with widths {listed}"


@words.register
def _(cause: residuals.Reversals) -> str:  # noqa: ARG001
    return "friction around reversals"


@words.register
def _(cause: residuals.FrictionLevel) -> str:  # noqa: ARG001
    return "a wrong level of friction (it follows the sign of the velocity)"


@words.register
def _(cause: residuals.ResidualRipple) -> str:
    return f"a ripple at {cause.frequency:.3g} Hz"


@words.register
def _(cause: residuals.LowFrequency) -> str:  # noqa: ARG001
    return f"an error of the model or its parameters (mostly below {residuals.LOW_FREQUENCY:g} Hz)"


@words.register
def _(cause: residuals.HighFrequency) -> str:  # noqa: ARG001
    return f"noise, ripple, elasticity or a time offset (mostly above {residuals.LOW_FREQUENCY:g} Hz)"


@words.register
def _(note: SmoothedAway) -> str:
    tail = f" (the most; likewise {join_names(note.joints[1:])})" if note.joints[1:] else ""
    return (
        f"{note.log}: what the smoothing took away follows the motion: {percent(note.share, 2)} of it, and with it "
        f"{percent(note.lost, 2)} of the acceleration of {note.joints[0]}{tail}; smooth less, by a smaller `factor` of "
        "the smoother, if the torque of held-out motion is then predicted better"
    )


@words.register
def _(failure: RunsAway) -> str:
    return f"the simulated position diverges after {short(failure.after)} s"


@words.register
def _(failure: Singular) -> str:  # noqa: ARG001
    return "the mass matrix is singular"


@words.register
def _(failure: Broken) -> str:
    return failure.reason


@words.register
def _(check: MassMatrixCheck) -> str:
    where = ", ".join(f"{short(x, 4)}" for x in check.q)
    if check.positive:
        return (
            f"The mass matrix is positive definite: smallest eigenvalue {short(check.smallest, 4)}, at q = ({where})."
        )
    return (
        f"The mass matrix is not positive definite: eigenvalue {short(check.smallest, 4)} at q = ({where}). "
        "These parameters are not physically consistent and cannot be simulated; excite the robot more, or constrain "
        "the fit."
    )


@words.register
def _(origin: Origin) -> str:
    kinds = {Measure.RESIDUAL: "residual of the fit", Measure.SCATTER: "scatter between neighbouring samples"}
    if origin.measured is None:
        return "as given"
    measured = kinds[origin.measured]
    return f"as given for {', '.join(origin.given_joints)}; else {measured}" if origin.given_joints else measured


def _parameters_are(number: int) -> str:
    return f"{number} parameter is" if number == 1 else f"{number} parameters are"
