"""Notes on the robot or its model, as data: each is the message of a ``Finding``.

``share`` is the share of the squared training residual, with each joint weighted by its own noise, that the
correction removes; ``std`` are standard errors robust to correlated residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from math import degrees

from dynident.runtime import Note, Use, WordedEnum, angles, percent, short, vector

MAX_CONTROL_COST, MAX_JOINT_COST = 10.0, 25.0  # %, of the torque and of one joint's, as the verdict's limits of errors
MAX_SIMULATION_COST = 5.0  # %, of the torque; what real robots have beside the usual terms is 2 to 4 %


class TermKind(StrEnum):
    """An effect that a model may lack: its ``effect`` in words, with "{}" for its size, its ``remedy``, and the
    ``term`` that has it, if one has.
    """

    effect: str
    term: str
    remedy: str

    def __new__(cls, value: str, effect: str, term: str = "", advice: str = "") -> TermKind:
        """Make a text that has all three; ``advice`` ends the remedy that is a term, else it is the remedy."""
        kind = str.__new__(cls, value)
        kind._value_, kind.effect, kind.term = value, effect, term
        kind.remedy = f"Add `{term}` to `terms` of the model{advice}." if term else advice
        return kind

    VISCOUS = "viscous", "viscous friction of {} N m s/rad or N s/m", "viscous"
    COULOMB = "coulomb", "Coulomb friction of {} N m or N", "coulomb"
    SMOOTH = (
        *("smooth sign of Coulomb friction", "Coulomb friction whose sign changes gradually, of {} N m or N", ""),
        "Set `coulomb_width` of the model (rad/s), or `min_speed`, which leaves slow samples out.",
    )
    OFFSET = "offset", "a constant torque of {} N m or N", "offset"
    ROTOR = "rotor", "rotor inertia of {} kg m^2 or kg", "rotor"
    SPRING = "spring", "a spring, or a cable that pulls back, of {} N m/rad or N/m", "spring"
    ASYMMETRIC = (
        *("asymmetric viscous friction", "friction that differs between the two directions, by {} N m s/rad or N s/m"),
        "asymmetric_viscous",
    )
    QUADRATIC = (
        *("quadratic friction", "friction that is not proportional to the velocity, of {} SI units of its square"),
        *("power", ", with its `exponent`"),
    )
    STRIBECK = (
        *("Stribeck friction", "friction that is different at low speed, by {} N m or N", "stribeck"),
        ", with the `velocity` at which it has fallen",
    )
    LOAD = "load-dependent friction", "friction that grows with the load, by {} of it", "load_coulomb"
    GEAR_LOSS = "gear loss", "a gear that loses {} of its torque, friction included", "load_coulomb"
    GAIN_DRIFT = (
        *("gain that drifts", "a torque whose gain changes over the recording, by {} of it in either half", ""),
        "Let motor and sensor warm up, and check whether the torque constant depends on the temperature.",
    )
    DRIFT = (
        *("friction that drifts", "friction that changes over the recording, by {} of it in either half", ""),
        "Let the robot warm up, and record training and validation in the same state.",
    )
    DELAY = (
        *("delay of the torque", "a torque that {1} the positions by {2} s", ""),
        "Shift this torque in the file, or does friction build up slowly? `time_offset` is the same for all joints.",
    )
    SATURATION = (
        *("torque that saturates", "saturation that takes {} of a torque of the usual size, of iron if negative", ""),
        "Does the drive saturate, or the iron of the motor, whose torque constant then falls with the current?",
    )
    COUPLED = (
        *("coupled motor", "a motor of {} kg m^2 that turns with both joints", ""),
        "Add it to `couplings` of the model.",
    )
    NEIGHBOUR = (
        *("torque of a neighbour", "the torque of a neighbouring joint times {}", ""),
        "Are these torques of motors that drive both joints, as in a differential? Convert them to joint torques.",
    )
    RIPPLE = (
        *("ripple", "a ripple, of cogging or of the gear, of {} N m or N", "ripple"),
        ", with its `cycles`, 2 pi by the period",
    )


class SuspectQuantity(WordedEnum):
    """The kinds of unknowns, with what their values mean."""

    GAIN = "gain", "a torque {:.3g} times as large"
    GEAR = "gear", "positions {:.3g} times as large"
    ZERO = "zero", "a zero that is off by {:.3g}"
    LENGTH = "length", "an origin moved by {:.3g} m"
    AXIS = "axis", "an axis or frame turned by {:.3g} rad"
    CLOCK = "clock", "time stamps whose second is {:.3g} s"


@dataclass(frozen=True)
class Rival:
    """Another unknown that explains the residual as well: the factor of a gain or clock, else a change in rad or m."""

    joint: str
    quantity: SuspectQuantity
    value: float

    def __str__(self) -> str:
        change = self.quantity.words.format(self.value)
        return f"joint {self.joint}: {change}" if self.joint else change


class Costly(Note):
    """Base of notes that forbid a use by what the fault costs.

    ``cost`` is the change of the torque, in % of all joints together, on the training motion at twice its speed;
    ``removed`` is the share that the correction removes of what is no white noise in the squared residual, by joint.
    """

    cost: float = field(default=0.0, kw_only=True)
    removed: tuple[tuple[str, float], ...] = field(default=(), kw_only=True)

    @property
    def forbidden(self) -> Use | None:
        """Control where the cost is large, simulation where it is more than a fit of a real robot leaves."""
        if self.cost > MAX_CONTROL_COST:
            return Use.CONTROL
        return Use.SIMULATION if self.cost > MAX_SIMULATION_COST else self.forbids

    @property
    def consequence(self) -> str:
        """What the fault changes, as a sentence."""
        return f"On this path at twice the speed it changes the torque by {percent(self.cost, 2)}."


class WrongValue(Costly):
    """Base of values that a model takes as known and that are wrong; ``joint_cost`` (%) is that of the worst joint.

    The user can correct them, so that any of them forbids simulation.
    """

    forbids = Use.SIMULATION
    joint_cost: float = field(default=0.0, kw_only=True)

    @property
    def forbidden(self) -> Use | None:
        """Control where a joint's torque is far off, else simulation."""
        return Use.CONTROL if self.joint_cost > MAX_JOINT_COST else self.forbids


class SuspectedValue(WrongValue):
    """Base of wrong values that the search found: the ``value`` as fitted, its ``std``, and the ``share`` it explains.

    ``others`` explain the residual as well.
    """

    key_figure = "value"
    value: float
    std: float
    share: float
    others: tuple[Rival, ...] = ()

    def explanation(self, claim: str, advice: str) -> str:
        """Return the sentences: a claim up to its verb, what setting it right removes and changes, and what to do."""
        rivals = "; ".join(map(str, self.others))
        doubt = (
            f" The data cannot tell this from: {rivals}. The change of the torque given here is the largest of theirs."
        )
        return (
            f"{claim} removes {100 * self.share:.0f} % of the squared training residual. {self.consequence} "
            f"{advice}{doubt * bool(rivals)}"
        )

    @property
    def remedy(self) -> str:
        """What to do about it, in short, with the likeliest of the others that may be wrong instead."""
        return self._short_advice() + (f" Or as likely: {self.others[0]}." if self.others else "")

    def _short_advice(self) -> str:
        raise NotImplementedError


class TorqueGain(SuspectedValue):
    """The torque of a joint is ``value`` times what the other joints require."""

    topic = "gain"

    def __str__(self) -> str:
        return self.explanation(
            f"the torque is {short(self.value)} +- {short(self.std, 2)} times what the coupling with the other joints "
            "asks for; setting it right",
            "Check its `gain`: gear ratio, torque constant, unit.",
        )

    def _short_advice(self) -> str:
        return f"check its `gain`: the torque is {short(self.value)} times what the other joints ask for."


class PositionGear(SuspectedValue):
    """The robot's joint moves ``value`` times as far as the logged position."""

    topic = "gear"

    def __str__(self) -> str:
        return self.explanation(
            f"the joint seems to move {short(self.value)} +- {short(self.std, 2)} times as far as logged, which",
            "Check the `gain` of its position: gear ratio, counts of the encoder, unit.",
        )

    def _short_advice(self) -> str:
        return f"check the `gain` of its position: the joint seems to move {short(self.value)} times as far as logged."


class ClockWrong(SuspectedValue):
    """A second of the stamps is ``value`` seconds."""

    topic = "clock"

    def __str__(self) -> str:
        return self.explanation(
            "according to the torque, a second of the time stamps lasts "
            f"{short(self.value)} +- {short(self.std, 2)} s, which",
            "Check the sampling rate, and the unit of the time.",
        )

    def _short_advice(self) -> str:
        return f"check the sampling rate and the unit of the time: a second seems to be {short(self.value)} s."


class ZeroOff(SuspectedValue):
    """The robot's joint stands at the logged position plus ``value`` (rad or m)."""

    topic = "zero"

    def __str__(self) -> str:
        return self.explanation(
            f"the robot's joint seems to be at the logged position {self.value:+.4g} +- {short(self.std, 2)} (rad or "
            "m), which",
            "Set `zero`, or correct the robot file.",
        )

    def _short_advice(self) -> str:
        return f"set `zero`: the joint seems to be at the logged position {self.value:+.3g} (rad or m)."


class LengthWrong(SuspectedValue):
    """A component ("x", "y" or "z", in the parent link's frame) of a joint's origin: ``given`` in the file (m)."""

    topic = "length"
    component: str = field(kw_only=True)
    given: float = field(kw_only=True)

    def __str__(self) -> str:
        return self.explanation(
            f"its origin has {self.component} = {short(self.given, 4)} m in the robot file, the torques fit "
            f"{short(self.value, 4)} +- {short(self.std, 2)} m, which",
            "Measure the link, and correct the file.",
        )

    def _short_advice(self) -> str:
        lengths = f"{short(self.value, 4)} m fit better than {short(self.given, 4)} m"
        return f"measure {self.component} of its origin: {lengths}."


class AxisTilted(SuspectedValue):
    """A joint's frame, or its axis ``alone``, is turned by ``value`` (rad) about an ``axis`` (3) of its own frame."""

    topic = "axis"
    axis: tuple[float, ...] = field(kw_only=True)
    alone: bool = field(kw_only=True)

    def __str__(self) -> str:
        return self.explanation(
            f"its {self._part} seems to be turned by {short(self.value)} +- {short(self.std, 2)} rad about "
            f"{vector(self.axis)} of the joint's frame, which",
            "Check the rotations in the robot file.",
        )

    @property
    def _part(self) -> str:
        return "axis" if self.alone else "frame"

    def _short_advice(self) -> str:
        return f"check its {self._part} in the robot file, which seems to be turned by {short(self.value, 2)} rad."


class TiltedBase(WrongValue):
    """The base is turned by ``x`` and then ``y`` (rad) about these axes; ``std`` of both; errors (%) of the torque."""

    topic = "base tilt"
    x: float
    y: float
    std: tuple[float, float]
    before: float
    after: float

    def __str__(self) -> str:
        std = [degrees(x) for x in self.std]
        return (
            f"The base is tilted by {angles(self.x, self.y, 2)} (+- {std[0]:.2f} and {std[1]:.2f}); with it, the "
            f"training error is {percent(self.after)} instead of {percent(self.before)}. {self.consequence} If it is, "
            "set `base_tilt: estimate` in the model."
        )

    @property
    def remedy(self) -> str:
        """What to do about it, in short."""
        return f"set `base_tilt: estimate`: the base seems to be tilted by {angles(self.x, self.y, 2)}."


class MissingTerm(Costly):
    """An effect that the model lacks at a joint: its value in SI units.

    ``share`` is that of the joint's own squared residual that it removes. ``partner`` is the other joint of a
    coupled motor or torque, ``period`` that of a ripple (rad or m). The value of a saturation is the share of the
    torque that is lost at its rms, negative where the torque shown is too large.
    """

    topic, key_figure = "missing term", "value"
    effect: TermKind
    value: float
    std: float
    share: float
    partner: str = ""
    period: float = 0.0

    def __str__(self) -> str:
        explained = f"would explain {100 * self.share:.0f} % of the joint's squared residual"
        return f"{self._effect_and_size} {explained}. {self.consequence} {self.effect.remedy}"

    @property
    def remedy(self) -> str:
        """What to do about it, in short."""
        return f"the model lacks {self._effect_and_size}. {self.effect.remedy}"

    @property
    def _effect_and_size(self) -> str:
        partner = f", together with {self.partner}" if self.partner else ""
        period = f", that repeats every {short(self.period)} rad or m" if self.period else ""
        size, length = (f"{short(value)} +- {short(self.std, 2)}" for value in (self.value, abs(self.value)))
        return self.effect.effect.format(size, "leads" if self.value < 0 else "lags", length) + partner + period


class TermLeftOut(MissingTerm):
    """A missing effect that the library has as a term, so that it forbids simulation at any cost."""

    forbids = Use.SIMULATION


class LeftAtReversals(Note):
    """The residual torque near the reversals of a joint.

    Within 50 ms of them, ``unexplained`` % more of its torque is unexplained than elsewhere. ``share`` is its share of
    the joint's squared residual as measured. Backlash and elastic gears do this, and friction that builds up
    gradually, which the torque alone does not tell. ``width`` (rad/s or m/s) is that of a friction whose sign turns
    smoothly and which explains it, 0 where none does.
    """

    topic = "unexplained"
    unexplained: float
    share: float
    width: float = 0.0

    def __str__(self) -> str:
        cause = (
            f"Friction that turns smoothly with the velocity explains it: set `coulomb_width` to about "
            f"{short(self.width, 2)} rad/s (m/s), or leave the terms to the logs (`terms: auto`)."
            if self.width
            else "Does the gear have backlash, or is the position measured at the motor of an elastic joint? Friction "
            "that builds up gradually looks the same. `min_speed` leaves slow samples out."
        )
        return (
            f"{percent(self.unexplained, 2)} of its torque is unexplained near its reversals (50 ms), beyond what is "
            f"unexplained elsewhere: {100 * self.share:.0f} % of the joint's squared residual. {cause}"
        )


class Unexplained(Note):
    """The low-passed torque that is neither white noise nor explained by anything searched: ``unexplained`` % of it.

    ``joint_unexplained`` (%) is that of the joint of the finding, of which the most is unexplained. The model lacks
    something, unless the sensors' noise is slow: that forbids simulation.
    """

    topic = "unexplained"
    forbids = Use.SIMULATION
    unexplained: float
    joint_unexplained: float

    def __str__(self) -> str:
        return (
            f"{percent(self.unexplained, 2)} of the torque is unexplained and not white noise, most at this joint "
            f"({percent(self.joint_unexplained, 2)} of its torque). None of the causes that were tried explains it. "
            "The model lacks an effect, unless the sensors have slow noise: look at the residual in the report."
        )
