"""Notes on what motions and control loops show, and on what is not looked for; each is the message of a ``Finding``."""

from __future__ import annotations

from dynident.checks.robot_notes import Costly
from dynident.runtime import Note, Remark, Severity, Use, WordedEnum, count, join_names, percent, short

ASTRAY = "Results of simulating the loop are less accurate than their standard errors say."


class NotSmoothed(Remark):
    """Why the motion of the recordings could not be found or fitted."""

    severity = Severity.ERROR
    topic = "motion"


class FewReversals(Note):
    """The number of reversals of a joint."""

    topic = "reversals"
    count: int

    def __str__(self) -> str:
        often = {0: "never reverses", 1: "reverses only once"}.get(self.count, f"reverses only {self.count} times")
        return (
            f"the joint {often}: friction, offset and gravity are then strongly correlated. Record a motion that goes "
            "back and forth."
        )


class HardlyMoves(Note):
    """The span of a joint in all of the training, and that of the joint that moves the most (rad or m).

    ``near`` is the middle of its positions.
    """

    topic = "still"
    span: float
    largest: float
    near: float
    unit: str

    def __str__(self) -> str:
        return (
            f"the joint hardly moves in training, by {short(self.span, 2)} {self.unit} where others move by up to "
            f"{short(self.largest, 2)}: its friction and rotor inertia cannot be identified, and its torque cannot be "
            "trusted where it does move. Record a motion of it, or hold it in the model: `lock` it at "
            f"{short(self.near, 4)}, and leave it out of `joints`, `position` and `torque`."
        )


class LoopDiffers(Note):
    """The share of a joint's torque by which its controller, at the measured motion, commands another one."""

    topic = "loop"
    error: float

    def __str__(self) -> str:
        return (
            f"the controller asks for a torque that differs from the measured one by {percent(100 * self.error)}. "
            f"Check its gains and its reference; or something else drives this joint, too. {ASTRAY}"
        )


class LoopGain(Note):
    """The measured torque is ``factor`` times what the controller commands.

    ``error`` and ``corrected_error`` are the differences between both without and with the factor, as shares of the
    torque.
    """

    topic = "loop"
    factor: float
    error: float
    corrected_error: float

    def __str__(self) -> str:
        return (
            f"the measured torque is {short(self.factor, 3)} times what the controller asks for (they differ by "
            f"{percent(100 * self.error)}, with this factor by {percent(100 * self.corrected_error)}). Check its gains "
            f"and that of the torque. {ASTRAY}"
        )


class LoopUnused(Note):
    """Columns that are named as reference positions but used by no controller."""

    severity = Severity.INFO
    topic = "loop"
    columns: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"columns are named as reference positions ({join_names(map(repr, self.columns), 2)}). Add the gains of "
            "the controller in a section `simulation`: the verdict then includes a free simulation, and the estimators "
            "that simulate the control loop can be used."
        )


class LoopVelocity(Note):
    """The number of steps over which drives difference positions: as ``given``, and as it fits the measured torque.

    ``error`` and ``corrected_error`` are the shares of the torque that do not fit with the given and with the fitted
    number; zero steps where the drives are faster than they are said to be.
    """

    topic = "loop"
    given: int
    steps: int
    error: float
    corrected_error: float

    def __str__(self) -> str:
        better = f"over {self.steps}" if self.steps else "with the velocity of the moment"
        setting = f"`velocity_steps: {self.steps}`, or the drive's `period`" if self.steps else "the drive's `period`"
        return (
            f"with its velocity over {count(self.given, 'step')}, the controller asks for a torque that differs from "
            f"the measured one by {percent(100 * self.error)}, {better} by {percent(100 * self.corrected_error)}. Give "
            f"{setting}. {ASTRAY}"
        )


class PositionBeyondLimits(Note):
    """The range of a position, and the one that the robot file allows (rad or m).

    ``far`` beyond it the position is a motor's.
    """

    topic = "position limit"
    lower: float
    upper: float
    least: float
    most: float
    far: bool = False

    @property
    def forbidden(self) -> Use | None:
        """Any where it is far beyond: the unit is then wrong, or the file's range."""
        return Use.CONTROL if self.far else None

    def __str__(self) -> str:
        return (
            f"the position runs from {short(self.lower, 4)} to {short(self.upper, 4)}, the file allows "
            f"{short(self.least, 4)} to {short(self.most, 4)}. "
            + (
                "Is it in another unit, or of a motor before its gear (see `transmission`)?"
                if self.far
                else "Check the unit, the sign and `zero`, or the file's limits."
            )
        )


class VelocityAboveLimit(Note):
    """A peak velocity and its limit in the robot file (rad/s or m/s)."""

    topic = "velocity limit"
    peak: float
    limit: float

    def __str__(self) -> str:
        return (
            f"the velocity reaches {short(self.peak, 4)}, the robot file allows {short(self.limit, 4)} (rad/s or "
            "m/s). Check the units of position and time; or the positions are too noisy for this smoother."
        )


class EffortAboveLimit(Note):
    """A peak torque and its limit in the robot file, in ``unit``.

    ``far`` above it the torque is another quantity or unit.
    """

    topic = "effort limit"
    peak: float
    limit: float
    unit: str
    far: bool

    def __str__(self) -> str:
        remedy = "Is it a motor current, or in another unit?" if self.far else "Check the unit and gain, or the file."
        return (
            f"the torque reaches {short(self.peak, 4)} {self.unit}, the robot file allows {short(self.limit, 4)}. "
            f"{remedy}"
        )


class EffortFarBelowLimit(Note):
    """A peak torque below a thousandth of its limit in the robot file, in ``unit``."""

    topic = "effort limit"
    peak: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return (
            f"the torque stays below {short(self.peak)} {self.unit}, a thousandth of the robot file's limit "
            f"{short(self.limit, 4)}. Is it on the motor side of the gear, in another unit, or is the limit a "
            "placeholder?"
        )


class CorrelatedParameters(Note):
    """The number of base parameters, and their condition number in these motions."""

    topic = "condition"
    rank: int
    condition: float

    def __str__(self) -> str:
        return (
            f"the {self.rank} base parameters are strongly correlated in these motions (condition number "
            f"{short(self.condition, 2)}): move more joints at the same time, faster, and over more of their range."
        )


class SearchKind(WordedEnum):
    """Kinds of searches that are skipped in a model of many joints."""

    FITS = (
        "fits",
        (
            "nothing was fitted: excitation, outliers of the torques, gravity, units and what explains the residual "
            "were not checked. Give joints that are not needed a position in `lock` of `model`."
        ),
    )
    CAUSES = (
        "causes",
        (
            "what explains the residual was not looked for: wrong gains, zeros, lengths and axes, missing terms, "
            "exchanged columns. Check a part of the joints, with the others in `lock` of `model`."
        ),
    )
    PAIRS = "pairs", "exchanged columns were looked for only among joints that follow each other."


class SearchLeftOut(Note):
    """A search that was skipped because the model has so many joints and parameters."""

    topic = "left out"
    search: SearchKind
    joints: int
    parameters: int

    def __str__(self) -> str:
        size = f"{count(self.parameters, 'parameter')} of {count(self.joints, 'joint')}"
        return f"the model has {size}, so that {self.search.words}"


class OtherPayload(Costly):
    """The last link is ``mass`` (kg) heavier in one log than in the other training logs.

    This explains ``share`` of the squared residual of all. A model of one payload is not valid for the other:
    any forbids simulation, and a large one control. The ``cost`` is the torque of the payload in that log.
    """

    topic = "payload"
    forbids = Use.SIMULATION
    mass: float
    std: float
    share: float

    def __str__(self) -> str:
        heavier = "heavier" if self.mass > 0 else "lighter"
        return (
            f"the last link is {short(abs(self.mass))} +- {short(self.std, 2)} kg {heavier} here than in the other "
            f"logs, which explains {100 * self.share:.0f} % of the squared residual. {self.consequence} Was there "
            "another payload? Give each payload its own model."
        )


class OddLog(Note):
    """One log does not fit together with the others.

    One fit of all logs leaves ``before`` % of the torque, mean over the joints; with a separate fit of this log
    ``after`` %. What was modelled has changed between the logs, so that it forbids simulation.
    """

    topic = "odd log"
    forbids = Use.SIMULATION
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"does not agree with the other logs: a common fit leaves {percent(self.before)} of the torque unexplained "
            f"(mean over the joints), a separate fit of this log {percent(self.after)}. Did the payload, a zero, the "
            "mounting or the temperature change, or does this file have other columns, signs or units? Correct it, or "
            "leave it out."
        )


class LowPassed(Note):
    """All torques were low-passed, at ``cutoff`` (Hz), rather than stamped late by ``lag`` (s).

    ``share`` is the share of the squared training residual that a filter of first order explains beyond late stamps;
    ``removed`` is that share by joint.
    """

    topic = "time offset"
    cutoff: float
    lag: float
    share: float
    removed: tuple[tuple[str, float], ...] = ()

    def __str__(self) -> str:
        return (
            f"the torques seem to be low-passed at about {short(self.cutoff, 2)} Hz, not delayed by "
            f"{short(1e3 * self.lag, 2)} ms: such a filter explains {100 * self.share:.0f} % of the squared training "
            f"residual that remains with the delay. {self._advice}"
        )

    @property
    def remedy(self) -> str:
        """What to do about it, in short."""
        return f"the torques seem to be low-passed at about {short(self.cutoff, 2)} Hz. {self._advice}"

    @property
    def _advice(self) -> str:
        return "Log them before the filter of the drive, or raise its cut-off; `min_speed` leaves reversals out."
