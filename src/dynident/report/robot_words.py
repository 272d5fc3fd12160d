"""Text for what the checks find wrong with the robot or its model, of ``checks/robot_notes.py``."""

from __future__ import annotations

from functools import singledispatch

import numpy as np

from dynident.checks import robot_notes
from dynident.checks.robot_notes import AffectedColumns, MissingTerm, Rival, SuspectQuantity, TermKind
from dynident.identification import BaseTilt
from dynident.report.note_words import words
from dynident.report.words import percent, short

EFFECTS = {
    TermKind.VISCOUS: ("viscous friction", "Add `viscous` to `terms` of the model."),
    TermKind.COULOMB: ("Coulomb friction", "Add `coulomb` to `terms` of the model."),
    TermKind.SMOOTH: (
        "Coulomb friction whose sign changes gradually",
        "Set `coulomb_width` of the model (rad/s), or `min_speed`, which leaves slow samples out.",
    ),
    TermKind.OFFSET: ("a constant torque", "Add `offset` to `terms` of the model."),
    TermKind.ROTOR: ("rotor inertia", "Add `rotor` to `terms` of the model."),
    TermKind.SPRING: ("a spring, or a cable that pulls back,", "Add `spring` to `terms` of the model."),
    TermKind.ASYMMETRIC: (
        "friction that differs between the two directions",
        "Add `asymmetric_viscous` to `terms` of the model.",
    ),
    TermKind.QUADRATIC: (
        "friction that is not proportional to the velocity",
        "Add `power` to `terms` of the model, with its `exponent`.",
    ),
    TermKind.STRIBECK: (
        "friction that is different at low speed",
        "Add `stribeck` to `terms` of the model, with the `velocity` at which it has fallen.",
    ),
    TermKind.LOAD: ("friction that grows with the load", "Add `load_coulomb` to `terms` of the model."),
    TermKind.DRIFT: (
        "friction that changes over the recording",
        "Let the robot warm up, and record training and validation in the same state.",
    ),
    TermKind.DELAY: (
        "a torque that is stamped late, by these seconds,",
        "Set `time_offset: estimate` where all joints are late alike; else shift this torque in the file.",
    ),
    TermKind.SATURATION: (
        "a torque that grows less than in proportion, by this share at its rms,",
        "Check whether the drive saturates, and how torque was computed from current.",
    ),
    TermKind.COUPLED: ("a motor that turns with both joints", "Add it to `couplings` of the model."),
    TermKind.NEIGHBOUR: (
        "so many times the torque of a neighbour",
        "Are these torques of motors that drive both joints, as in a differential? Convert them to joint torques.",
    ),
    TermKind.RIPPLE: (
        "a ripple, of cogging or of the gear, with this amplitude",
        "Add `ripple` to `terms` of the model, with its `cycles`, 2 pi by the period.",
    ),
}

RIVALS = {
    SuspectQuantity.GAIN: "a torque {:.3g} times as large",
    SuspectQuantity.ZERO: "a zero that is off by {:.3g}",
    SuspectQuantity.LENGTH: "an origin moved by {:.3g} m",
    SuspectQuantity.AXIS: "an axis or frame turned by {:.3g} rad",
    SuspectQuantity.CLOCK: "time stamps whose second is {:.3g} s",
}


def _percent(share: float) -> str:
    return f"{100 * share:.0f} % of the squared training residual"


def _rivals(rivals: tuple[Rival, ...]) -> str:
    """Return the rival explanations that explain as much, as a sentence."""
    places = [f"joint {rival.joint}: " if rival.joint else "" for rival in rivals]
    listed = "; ".join(
        at + RIVALS[rival.quantity].format(rival.value) for at, rival in zip(places, rivals, strict=True)
    )
    if not rivals:
        return ""
    return f" The data cannot tell this from: {listed}. The change of the torque given here is the largest of theirs."


def _cost(note: robot_notes.Costly) -> str:
    """Return the effect of a fault on the torque at twice the speed, as a sentence."""
    return f"On this path at twice the speed it changes the torque by {percent(note.cost, 2)}."


def _frame_word(note: robot_notes.AxisTilted) -> str:
    return "axis" if note.alone else "frame"


def _vector(axis: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{short(x)}" for x in axis) + ")"


def _error_change(before: float, after: float) -> str:
    return f"the mean torque error then falls from {short(before)} to {percent(after)}"


@singledispatch
def remedy(note: object) -> str:
    """Return in short what to do about a finding; the whole text where there is no shorter one."""
    return words(note)


@remedy.register
def _(note: MissingTerm) -> str:
    effect, how = EFFECTS[note.effect]
    partner = f" together with {note.partner}" if note.partner else ""
    return f"the model lacks {effect.removesuffix(',')}{partner}. {how}"


@remedy.register
def _(note: robot_notes.TorqueGain) -> str:
    return f"check its `gain`: the torque is {short(note.factor)} times what the other joints ask for."


@remedy.register
def _(note: robot_notes.ClockWrong) -> str:
    return f"check the sampling rate and the unit of the time: a second seems to be {short(note.factor)} s."


@remedy.register
def _(note: robot_notes.ZeroOff) -> str:
    return f"set `zero`: the joint seems to be at the logged position {note.offset:+.3g} (rad or m)."


@remedy.register
def _(note: robot_notes.LengthWrong) -> str:
    return (
        f"measure {note.component} of its origin: {short(note.fitted, 4)} m fit better than {short(note.given, 4)} m."
    )


@remedy.register
def _(note: robot_notes.AxisTilted) -> str:
    return f"check its {_frame_word(note)} in the robot file, which seems to be turned by {short(note.angle, 2)} rad."


@remedy.register
def _(note: robot_notes.TiltedBase) -> str:
    x, y = np.rad2deg((note.x, note.y))
    return f"set `base_tilt: estimate`: the base seems to be tilted by {x:z.2f} deg about x and {y:z.2f} deg about y."


@words.register
def _(note: robot_notes.JointsSwapped) -> str:
    joint, partner = note.joints
    columns = {
        AffectedColumns.POSITION: "position columns",
        AffectedColumns.TORQUE: "torque columns",
        AffectedColumns.BOTH: "columns of position and torque",
    }
    return (
        f"are the {columns[note.channel]} of {joint} and {partner} exchanged? With them the other way round "
        f"{_error_change(note.before, note.after)}. Check the columns in the configuration."
    )


@words.register
def _(note: robot_notes.ColumnReversed) -> str:
    verb = "have" if note.channel is AffectedColumns.BOTH else "has"
    return (
        f"{note.channel.value} {verb} the opposite sign? With it reversed {_error_change(note.before, note.after)}. "
        "Set a negative `gain`, or reverse the axis in the robot file."
    )


@words.register
def _(note: robot_notes.OtherAxis) -> str:
    return (
        f"is the axis right? With {_vector(note.fitted)} instead of {_vector(note.given)}, in the joint's frame, "
        f"{_error_change(note.before, note.after)}. Check the axis in the robot file, and the columns."
    )


@words.register
def _(note: robot_notes.TorqueGain) -> str:
    return (
        f"the torque is {short(note.factor)} +- {short(note.std, 2)} times what the coupling with the other "
        "joints asks for; "
        f"setting it right removes {_percent(note.share)}. {_cost(note)} Check its `gain`: gear ratio, torque "
        f"constant, unit.{_rivals(note.others)}"
    )


@words.register
def _(note: robot_notes.ClockWrong) -> str:
    return (
        f"by the torque, a second of the time stamps is {short(note.factor)} +- {short(note.std, 2)} s, which "
        f"removes {_percent(note.share)}. {_cost(note)} Check the sampling rate, and the unit of the time."
        f"{_rivals(note.others)}"
    )


@words.register
def _(note: robot_notes.ZeroOff) -> str:
    return (
        f"the robot's joint seems to be at the logged position {note.offset:+.4g} +- {short(note.std, 2)} (rad or "
        "m), which "
        f"removes {_percent(note.share)}. {_cost(note)} Set `zero`, or correct the robot file.{_rivals(note.others)}"
    )


@words.register
def _(note: robot_notes.LengthWrong) -> str:
    return (
        f"its origin has {note.component} = {short(note.given, 4)} m in the robot file, the torques ask for "
        f"{short(note.fitted, 4)} +- {short(note.std, 2)} m, which removes {_percent(note.share)}. {_cost(note)} "
        "Measure the link, "
        f"and correct the file.{_rivals(note.others)}"
    )


@words.register
def _(note: robot_notes.AxisTilted) -> str:
    return (
        f"its {_frame_word(note)} seems to be turned by {short(note.angle)} +- {short(note.std, 2)} rad about "
        f"{_vector(note.axis)} "
        f"of the joint's frame, which removes {_percent(note.share)}. {_cost(note)} Check the rotations in the robot "
        f"file.{_rivals(note.others)}"
    )


@words.register
def _(note: MissingTerm) -> str:
    effect, remedy = EFFECTS[note.effect]
    partner = f" together with {note.partner}" if note.partner else ""
    period = f" that repeats every {short(note.period)} rad or m" if note.period else ""
    return (
        f"{effect}{partner}{period} ({short(note.value)} +- {short(note.std, 2)}, SI units) would explain "
        f"{100 * note.share:.0f} % of the joint's squared residual. {_cost(note)} {remedy}"
    )


@words.register
def _(note: robot_notes.LeftAtReversals) -> str:
    return (
        f"{percent(note.left, 2)} of its torque is left near its reversals (50 ms), beyond what is left elsewhere: "
        f"{100 * note.share:.0f} % of the joint's squared residual. Has the gear backlash, or is the position that of "
        "a motor behind an elastic joint? Friction that builds up gradually looks alike. `min_speed` leaves slow "
        "samples out."
    )


@words.register
def _(note: robot_notes.Unexplained) -> str:
    return (
        f"{percent(note.left, 2)} of all torque is left that is not white noise, the most at this joint "
        f"({percent(note.joint_left, 2)} of its own), and no cause that was tried explains it. The model lacks "
        "something, unless the noise of the sensors is slow: look at the residual in the report."
    )


@words.register
def _(note: robot_notes.TiltedBase) -> str:
    text = words(BaseTilt(note.x, note.y, note.std, note.before, note.after))
    return f"{text[0].upper()}{text[1:]}. {_cost(note)} If it is, set `base_tilt: estimate` in the model."


@words.register
def _(note: robot_notes.OtherPayload) -> str:
    heavier = "heavier" if note.mass > 0 else "lighter"
    return (
        f"the last link is {short(abs(note.mass))} +- {short(note.std, 2)} kg {heavier} here than in training, "
        "which explains "
        f"{100 * note.share:.0f} % of the squared residual. {_cost(note)} Was there another payload? Give each payload "
        "its own model."
    )


@words.register
def _(note: robot_notes.OddLog) -> str:
    return (
        f"does not fit together with the other logs: one fit of all leaves {percent(note.before)} of the torque (mean "
        f"over the joints), with a fit of its own for this log {percent(note.after)}. Have the payload, a zero, the "
        "mounting or the temperature changed in between, or are columns, signs or units others in this file? Correct "
        "it, or leave it out."
    )
