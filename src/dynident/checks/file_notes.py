"""Notes on the robot file, and on columns that contradict it; each is the message of a ``Finding``."""

from __future__ import annotations

from math import radians

from dynident.runtime import Note, Remark, Severity, Use, WordedEnum, join_names, percent, short, vector

FROM_CAD = "Take it from CAD, or identify it with `kind: consistent`."


class Unread(Remark):
    """What is in a robot file and was not read."""

    severity = Severity.INFO
    topic = "unread"


class Unusable(Remark):
    """Why a file cannot be checked."""

    severity = Severity.ERROR
    topic = "unusable"


class GravityIgnored(Note):
    """The gravity of a robot file (m/s^2), and the one that is used instead."""

    topic = "gravity"
    given: tuple[float, ...]
    used: tuple[float, ...]

    def __str__(self) -> str:
        return (
            f"the file's gravity {self.given} is ignored; {self.used} m/s^2 is used. Set `gravity` if the arm is "
            "mounted that way."
        )


class OtherGravity(Note):
    """The gravity that the torques fit and the one assumed (m/s^2, in the root link's frame)."""

    topic = "gravity"
    forbids = Use.CONTROL
    fitted: tuple[float, ...]
    assumed: tuple[float, ...]

    def __str__(self) -> str:
        return (
            f"is gravity right? The torques fit a gravity of about {vector(self.fitted)} m/s^2 in the root link's "
            f"frame, not {vector(self.assumed, 4)}. Set `gravity` if the arm is mounted that way; otherwise check the "
            "signs of all torques and positions, and `zero`."
        )


class ReversedSign(Note):
    """A torque that opposes the nominal one, by its correlation.

    None where friction and inertia come out negative instead.
    """

    topic = "sign"
    forbids = Use.CONTROL
    correlation: float | None

    def __str__(self) -> str:
        why = "friction and inertia of the joint are estimated as negative"
        if self.correlation is not None:
            why = f"it opposes the torque of the robot file's inertias (correlation {self.correlation:z.2f})"
        return (
            f"is the sign of the torque reversed? In this motion {why}. Check the signs of `gain` and `transmission`, "
            "and that position and torque have the same positive direction."
        )


class OddScale(Note):
    """A torque of ``scale`` times the nominal one, which should be in ``unit``."""

    topic, key_figure = "scale", "scale"
    forbids = Use.CONTROL
    scale: float
    unit: str

    def __str__(self) -> str:
        return (
            f"the torque is {short(self.scale)} times that of the robot file's inertias. Is a gear ratio, a torque "
            f"constant or a unit missing in `gain`, or is `gravity` not in m/s^2? The torque should be in {self.unit}."
        )


class UnrelatedTorque(Note):
    """A torque that hardly correlates with the nominal one, which is ``ratio`` times as large."""

    topic = "foreign"
    forbids = Use.CONTROL
    ratio: float
    correlation: float

    def __str__(self) -> str:
        return (
            "does this torque belong to this joint? It hardly correlates with the torque of the robot file's "
            f"inertias, which is {short(self.ratio, 2)} times as large (correlation {self.correlation:z.2f}). Check "
            "the column."
        )


class ImpossibleInertia(Note):
    """How the inertia of a link violates physical consistency, in the words of ``consistency_violations``."""

    topic = "impossible"
    violation: str

    def __str__(self) -> str:
        return f"{self.violation}. No body can have such an inertia. {FROM_CAD}"


class NoMass(Note):
    """The links that a joint moves have no mass."""

    topic = "massless"
    links: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"the links that the joint moves ({', '.join(self.links)}) have no mass in the file: simulators reject "
            f"this, and it gives no prior. {FROM_CAD}"
        )


class FloatingBase(Note):
    """A joint with several coordinates carries the whole robot, which is taken as fixed."""

    topic = "floating"

    def __str__(self) -> str:
        return (
            "it lets the whole robot float or drive, but only a fixed base is supported: it is taken as fixed. "
            "Record with the base clamped, as what it feels of a moving one is not modelled."
        )


class SeveralLimbs(Note):
    """Several joints move limbs of a base with a mass, which is taken as fixed; it may be a trunk."""

    severity = Severity.INFO
    topic = "limbs"
    base: str
    joints: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"several limbs move from the base {self.base!r}, which is taken as fixed "
            f"({join_names(self.joints, 4)}): right for arms on a stand; a walking robot must be clamped at its trunk."
        )


class OnlyShapes(Note):
    """A link has shapes of files instead of an inertia."""

    severity = Severity.INFO
    topic = "shapes"

    def __str__(self) -> str:
        return (
            "its inertia follows from meshes or height fields that were not found or cannot be read: put them where "
            "the file says, or save the compiled model from MuJoCo with <compiler saveinertial='true'/>, which writes "
            "the inertia out."
        )


class PointMass(Note):
    """A link has a mass (kg) without an inertia about its centre."""

    severity = Severity.INFO
    topic = "point"
    mass: float

    def __str__(self) -> str:
        return (
            f"{short(self.mass, 4)} kg without an inertia about the centre of mass: a point mass, or an inertia "
            "rounded to zero."
        )


class FarCentre(Note):
    """The distance (m) of a centre of mass from its link's frame."""

    topic = "far"
    distance: float

    def __str__(self) -> str:
        return (
            f"its centre of mass is {short(self.distance, 4)} m from its frame. Is it in millimetres, or in another "
            "frame? A URDF gives metres in the link's own frame."
        )


class LargeGyration(Note):
    """A largest moment (kg m^2) and its radius of gyration (m), large for the mass (kg) and size (m) of the link."""

    topic = "spread"
    moment: float
    gyration: float
    mass: float
    size: float

    def __str__(self) -> str:
        return (
            f"its largest moment {short(self.moment)} kg m^2 means a radius of gyration of {short(self.gyration, 2)} "
            f"m for its {short(self.mass)} kg, on a link of about {short(self.size, 2)} m. Is it about another point, "
            "or a placeholder? It would be a misleading prior."
        )


class InertiaAboutOrigin(Note):
    """The links whose inertias may be about the origins of their frames."""

    topic = "about origin"
    links: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"the inertias of {', '.join(self.links)} are as large as if they were about the origins of the links' "
            "frames. A robot file gives them about the centre of mass; if that was overlooked, subtract m c^2 "
            "(parallel axes)."
        )


class EqualLinks(Note):
    """Links with the same mass (kg) and moments; ``alone`` says that there are no others."""

    topic = "copied"
    links: tuple[str, ...]
    mass: float
    alone: bool

    def __str__(self) -> str:
        description = f"have the same mass {short(self.mass, 4)} kg and the same moments:"
        if self.alone:
            return f"all links {description} placeholders? {FROM_CAD}"
        return f"{', '.join(self.links)} {description} copied, or simple shapes? They are a weak prior."


class OddTotalMass(Note):
    """A mass of all links (kg) that no arm has."""

    topic = "total mass"
    mass: float

    def __str__(self) -> str:
        return f"the total mass of all links is {short(self.mass, 4)} kg. Are the masses in kg?"


class EmptyRange(Note):
    """A lower limit of position that is not below the upper one (rad or m)."""

    topic = "limits"
    lower: float
    upper: float

    def __str__(self) -> str:
        return (
            f"its lower limit {self.lower:g} is not below its upper limit {self.upper:g}: simulators use it as given. "
            "Correct it."
        )


class LimitNotPositive(Note):
    """A limit that is not positive: of "effort" or "velocity"."""

    topic = "limits"
    quantity: str
    value: float

    def __str__(self) -> str:
        return f"its {self.quantity} limit is {self.value:g}: simulators use it as given. Correct it."


class NoLimit(Note):
    """The joints without a limit of "effort" or "velocity"."""

    severity = Severity.INFO
    topic = "limits"
    quantity: str
    joints: tuple[str, ...]

    def __str__(self) -> str:
        return f"no {self.quantity} limit for {', '.join(self.joints)}: recordings cannot be checked against it."


class AffectedColumns(WordedEnum):
    """The columns of a log that are affected."""

    POSITION = "position", "position columns"
    TORQUE = "torque", "torque columns"
    BOTH = "position and torque", "columns of position and torque"


class JointsSwapped(Note):
    """Columns fit better if each joint has those of the next, in a cycle; ``before``, ``after``: mean errors (%)."""

    topic = "swapped"
    forbids = Use.CONTROL
    joints: tuple[str, ...]
    channel: AffectedColumns
    before: float
    after: float

    def __str__(self) -> str:
        joints, others = self.joints, (*self.joints[1:], self.joints[0])
        return (
            f"are the {self.channel.words} of {', '.join(joints)} exchanged? With those of {', '.join(others)} instead "
            f"{_error_change(self.before, self.after)}. Check the columns in the configuration."
        )


class ColumnReversed(Note):
    """The columns of a joint, and of ``others``, fit with the other sign; errors (%) as above."""

    topic = "sign"
    forbids = Use.CONTROL
    channel: AffectedColumns
    others: tuple[str, ...]
    before: float
    after: float

    def __str__(self) -> str:
        verb = "have" if self.channel is AffectedColumns.BOTH else "has"
        return (
            f"{self.channel.value} {verb} the opposite sign{', as those of ' if self.others else ''}"
            f"{', '.join(self.others)}? With it reversed {_error_change(self.before, self.after)}. "
            "Set a negative `gain`, or reverse the axis in the robot file."
        )


class OtherZero(Note):
    """The robot's joint seems to stand ``angle`` (deg) beyond the logged position; errors (%) as above."""

    topic = "zero"
    forbids = Use.CONTROL
    angle: int
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"is the zero right? With {self.angle:+} deg added to the position "
            f"{_error_change(self.before, self.after)}. Add {radians(self.angle):.4f} rad to `zero`, or correct "
            "the robot file."
        )


class MotorCoupled(Note):
    """The columns of ``joint`` are those of a motor that turns with it and ``coefficient`` times ``partner``.

    Errors (%) as above.
    """

    topic = "coupled"
    forbids = Use.CONTROL
    joint: str
    partner: str
    coefficient: int
    channel: AffectedColumns
    before: float
    after: float

    def __str__(self) -> str:
        motor = f"{{ {self.joint}: 1, {self.partner}: {self.coefficient} }}"
        couplings = f"couplings: {{ {self.joint}_motor: {{ joints: {motor} }} }}"
        advice = f"Set `transmission: {{ {self.joint}: {motor} }}`, with its gear ratios, and `{couplings}` in `model`."
        if self.channel is AffectedColumns.POSITION:
            advice = f"{'Subtract' if self.coefficient > 0 else 'Add'} the position of {self.partner} in the file."
        return (
            f"does its motor turn with {self.partner}, too? With {self.channel.value} of {motor} "
            f"{_error_change(self.before, self.after)}. {advice}"
        )


class OtherAxis(Note):
    """Another axis (3) of a joint, in its own frame, fits better than that of the file; errors (%) as above."""

    topic = "axis"
    forbids = Use.CONTROL
    given: tuple[float, ...]
    fitted: tuple[float, ...]
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"is the axis right? With {vector(self.fitted)} instead of {vector(self.given)}, in the joint's frame, "
            f"{_error_change(self.before, self.after)}. Check the axis in the robot file, and the columns."
        )


def _error_change(before: float, after: float) -> str:
    return f"the mean torque error then falls from {short(before)} to {percent(after)}"
