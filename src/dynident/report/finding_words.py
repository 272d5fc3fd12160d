"""Text for the findings of the checks; one small function per note of ``checks/notes.py``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.checks import log_notes, notes, reading_words
from dynident.identification import BaseTilt, TimeOffset
from dynident.report import log_words, robot_words  # noqa: F401  # register their words
from dynident.report.note_words import words
from dynident.report.words import count, percent, short
from dynident.runtime import join_names

if TYPE_CHECKING:
    from dynident.runtime import Finding


ASTRAY = "What is found by simulating the loop is wrong by more than its errors say."
REMEDY = "Take it from CAD, or identify it with `kind: consistent`."


def finding_words(finding: Finding) -> str:
    """Return what was found and what to do, as a sentence, without the place."""
    text = words(finding.message)
    if isinstance(finding.message, TimeOffset):
        return f"Time offset: {text}."
    if isinstance(finding.message, BaseTilt):
        return f"{text[0].upper()}{text[1:]}. If the base may be tilted, set `base_tilt: estimate` in the model."
    return text


@words.register
def _(note: notes.ReadingNote) -> str:
    return reading_words(note)


@words.register
def _(note: notes.StampsJitter) -> str:
    if note.step is None:
        remedy = f"Set `time: {{ rate: {note.rate:.6g} }}` instead of the column, and compare the held-out error"
    else:
        remedy = f"Round the stamps to multiples of {note.step:.6g} s in the file"
    return (
        f"{_vary(note.jitter)} would be {_times(note.factor)} less noisy with equal spacing: the sampling is regular "
        f"and the stamps are not. {remedy}."
    )


@words.register
def _(note: notes.SamplingJitter) -> str:
    axis = "do not show whether the stamps or the sampling jitter"
    if note.factor is not None:
        axis = f"would be {_times(note.factor)} noisier with equal spacing: the sampling itself jitters"
    return f"{_vary(note.jitter)} {axis}. Keep the stamps, and use the spline smoother, which needs no equal spacing."


@words.register
def _(note: notes.LostSamples) -> str:
    return (
        f"about {count(note.count, 'sample')} ({percent(100 * note.share, 2)}) {'is' if note.count == 1 else 'are'} "
        f"lost, in steps of up to {note.longest:.0f} times "
        "the median: a spline bridges them if the time is taken from the stamps and not from a `rate`."
    )


@words.register
def _(note: notes.RepeatedPositions) -> str:
    remedy = "Drop the repeated rows if the torque repeats as well; else choose the smoothing with `rule: torque`."
    if note.every > 1:
        remedy = f"Keep only one row in {note.every}, the first with each new value."
    return (
        f"{percent(100 * note.share, 2)} of the positions exactly repeat the previous one although the joint moves: "
        f"the encoder is read less often than it is logged. {remedy}"
    )


@words.register
def _(note: notes.ImpossibleInertia) -> str:
    return f"{note.violation}. No body can have such an inertia. {REMEDY}"


@words.register
def _(note: notes.NoMass) -> str:
    return (
        f"the links that the joint moves ({', '.join(note.links)}) have no mass in the file: simulators reject "
        f"this, and it gives no prior. {REMEDY}"
    )


@words.register
def _(note: notes.FloatingBase) -> str:  # noqa: ARG001
    return (
        "it lets the whole robot float or drive, but only a fixed base is supported: it is taken as fixed. Record with "
        "the base clamped, as what it feels of a moving one is not modelled."
    )


@words.register
def _(note: notes.SeveralLimbs) -> str:
    return (
        f"{len(note.joints)} limbs move from the base {note.base!r}, which is taken as fixed "
        f"({join_names(note.joints, 4)}): right for arms on a stand; a walking robot must be clamped at its trunk."
    )


@words.register
def _(note: notes.OnlyShapes) -> str:  # noqa: ARG001
    return (
        "its inertia follows from meshes or height fields, which are not read; save the compiled model from MuJoCo "
        "with <compiler saveinertial='true'/>, which writes the inertia out."
    )


@words.register
def _(note: notes.PointMass) -> str:
    return (
        f"{short(note.mass, 4)} kg without an inertia about the centre of mass: a point mass, or an inertia "
        "rounded to zero."
    )


@words.register
def _(note: notes.FarCentre) -> str:
    return (
        f"its centre of mass is {short(note.distance, 4)} m from its frame. Is it in millimetres, or in another frame? "
        "A URDF gives metres in the link's own frame."
    )


@words.register
def _(note: notes.LargeGyration) -> str:
    return (
        f"its largest moment {short(note.moment)} kg m^2 means a radius of gyration of {short(note.gyration, 2)} m for "
        f"its {short(note.mass)} kg, on a link of about {short(note.size, 2)} m. Is it about another point, or a "
        "placeholder? It would be a misleading prior."
    )


@words.register
def _(note: notes.InertiaAboutOrigin) -> str:
    return (
        f"the inertias of {', '.join(note.links)} are as large as if they were about the origins of the links' frames. "
        "A robot file gives them about the centre of mass; if that was overlooked, subtract m c^2 (parallel axes)."
    )


@words.register
def _(note: notes.EqualLinks) -> str:
    description = f"have the same mass {short(note.mass, 4)} kg and the same moments:"
    if note.alone:
        return f"all links {description} placeholders? {REMEDY}"
    return f"{', '.join(note.links)} {description} copied, or simple shapes? They are a weak prior."


@words.register
def _(note: notes.OddTotalMass) -> str:
    return f"the total mass of all links is {short(note.mass, 4)} kg. Are the masses in kg?"


@words.register
def _(note: notes.EmptyRange) -> str:
    return (
        f"its lower limit {note.lower:g} is not below its upper limit {note.upper:g}: simulators use it as given. "
        "Correct it."
    )


@words.register
def _(note: notes.LimitNotPositive) -> str:
    return f"its {note.quantity} limit is {note.value:g}: simulators use it as given. Correct it."


@words.register
def _(note: notes.NoLimit) -> str:
    return f"no {note.quantity} limit for {', '.join(note.joints)}: recordings cannot be checked against it."


@words.register
def _(note: notes.GravityIgnored) -> str:
    return (
        f"the file's gravity {note.given} is ignored; {note.used} m/s^2 is used. "
        "Set `gravity` if the arm is mounted that way."
    )


@words.register
def _(note: notes.OtherGravity) -> str:
    estimated, assumed = (
        ", ".join(f"{x:{form}}" for x in g) for g, form in ((note.fitted, ".1f"), (note.assumed, ".4g"))
    )
    return (
        f"is gravity right? The torques fit a gravity of about ({estimated}) m/s^2 in the root link's frame, "
        f"not ({assumed}). Set `gravity` if the arm is mounted that way; "
        "otherwise check the signs of all torques and positions, and `zero`."
    )


@words.register
def _(note: notes.ReversedSign) -> str:
    why = "friction and inertia of the joint are estimated as negative"
    if note.correlation is not None:
        why = f"it opposes the torque of the robot file's inertias (correlation {note.correlation:z.2f})"
    return (
        f"is the sign of the torque reversed? In this motion {why}. Check the signs of `gain` and "
        "`transmission`, and that position and torque have the same positive direction."
    )


@words.register
def _(note: notes.OddScale) -> str:
    return (
        f"the torque is {short(note.scale)} times that of the robot file's inertias. Is a gear ratio, a torque "
        f"constant or a unit missing in `gain`? It should be in {note.unit}."
    )


@words.register
def _(note: notes.UnrelatedTorque) -> str:
    return (
        "does this torque belong to this joint? It hardly correlates with the torque of the robot file's inertias, "
        f"which is {short(note.ratio, 2)} times as large (correlation {note.correlation:z.2f}). Check the column."
    )


@words.register
def _(note: log_notes.FewReversals) -> str:
    often = {0: "never reverses", 1: "reverses only once"}.get(note.count, f"reverses only {note.count} times")
    return (
        f"the joint {often}: friction, offset and gravity are then strongly correlated. "
        "Record a motion that goes back and forth."
    )


@words.register
def _(note: log_notes.HardlyMoves) -> str:
    return (
        f"the joint hardly moves in training, by {short(note.span, 2)} {note.unit} where others move by up to "
        f"{short(note.largest, 2)}: nothing is seen of its friction and rotor, and where it does move its torque is "
        f"not to be relied on. Record a motion of it, or hold it in the model: `lock` it at {short(note.near, 4)}, "
        "and leave it out of `joints`, `position` and `torque`."
    )


@words.register
def _(note: log_notes.LoopVelocity) -> str:
    better = f"over {note.steps}" if note.steps else "with the velocity of the moment"
    setting = f"`velocity_steps: {note.steps}`, or the drive's `period`" if note.steps else "the drive's `period`"
    return (
        f"with its velocity over {count(note.given, 'step')}, the controller asks for a torque that differs from the "
        f"measured one by {percent(100 * note.error)}, {better} by {percent(100 * note.left)}. Give {setting}. {ASTRAY}"
    )


@words.register
def _(note: log_notes.LoopGain) -> str:
    return (
        f"the measured torque is {short(note.factor, 3)} times what the controller asks for (they differ by "
        f"{percent(100 * note.error)}, with this factor by {percent(100 * note.left)}). Check its gains and that of "
        f"the torque. {ASTRAY}"
    )


@words.register
def _(note: log_notes.LoopDiffers) -> str:
    return (
        f"the controller asks for a torque that differs from the measured one by {percent(100 * note.error)}. Check "
        f"its gains and its reference; or something else drives this joint, too. {ASTRAY}"
    )


@words.register
def _(note: log_notes.LoopUnused) -> str:
    return (
        f"columns are named as reference positions ({join_names(map(repr, note.columns), 2)}). With the gains of the "
        "drives, in the section `simulation`, estimators that simulate the loop apply as well, and the model is judged "
        "in it."
    )


@words.register
def _(note: log_notes.PositionBeyondLimits) -> str:
    return (
        f"the position runs from {short(note.lower, 4)} to {short(note.upper, 4)}, the file allows "
        f"{short(note.least, 4)} to "
        f"{short(note.most, 4)}. "
        + (
            "Is it in another unit, or of a motor before its gear (see `transmission`)?"
            if note.far
            else "Check the unit, the sign and `zero`, or the file's limits."
        )
    )


@words.register
def _(note: log_notes.VelocityAboveLimit) -> str:
    return (
        f"the velocity reaches {short(note.peak, 4)}, the robot file allows {short(note.limit, 4)} (rad/s or m/s). "
        "Check the units of position and time; or the positions are too noisy for this smoother."
    )


@words.register
def _(note: log_notes.EffortAboveLimit) -> str:
    remedy = "Is it a motor current, or in another unit?" if note.far else "Check the unit and gain, or the file."
    return (
        f"the torque reaches {short(note.peak, 4)} {note.unit}, the robot file allows {short(note.limit, 4)}. {remedy}"
    )


@words.register
def _(note: log_notes.EffortFarBelowLimit) -> str:
    return (
        f"the torque stays below {short(note.peak)} {note.unit}, a thousandth of the robot file's limit "
        f"{short(note.limit, 4)}. "
        "Is it on the motor side of the gear, in another unit, or is the limit a placeholder?"
    )


@words.register
def _(note: log_notes.CorrelatedParameters) -> str:
    return (
        f"the {note.rank} base parameters are strongly correlated in these motions (condition number "
        f"{short(note.condition, 2)}): move more joints at the same time, faster, and over more of their range."
    )


def _vary(jitter: float) -> str:
    return f"the time steps vary by {percent(100 * jitter, 2)} rms, and the positions"


def _times(factor: float) -> str:
    if factor > 1000:
        return "over 1000 times"
    return f"{short(factor)} times" if factor >= 2 else f"{100 * (factor - 1):.0f} %"


@words.register
def _(note: log_notes.SearchLeftOut) -> str:
    left_out = {
        log_notes.SearchKind.FITS: "nothing was fitted: excitation, outliers of the torques, gravity, units and "
        "what explains the residual were not checked. Give joints that are not needed a position in `lock` of `model`.",
        log_notes.SearchKind.CAUSES: "what explains the residual was not looked for: wrong gains, zeros, lengths "
        "and axes, missing terms, exchanged columns. Check a part of the joints, with the others in `lock` of `model`.",
        log_notes.SearchKind.PAIRS: "exchanged columns were looked for only among joints that follow each other.",
    }
    size = f"{count(note.parameters, 'parameter')} of {count(note.joints, 'joint')}"
    return f"the model has {size}, so that {left_out[note.search]}"
