"""Which seconds to leave out of the training, and which speeds it lacks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

import numpy as np

from dynident.identification.result import Identification
from dynident.runtime import Finding, Statement, TaggedUnion, number, rough
from dynident.validation import LogValidation


class Remedy(StrEnum):
    """What to do about a reason against a use."""

    CORRECT = "Correct what was found, as the reasons say, and identify again."
    HOLD_OUT = (
        "Record another motion and name it under `validation`; windows of one recording are enough for a first check."
    )
    ANOTHER_MOTION = (
        "Record a held-out motion with other paths and speeds; a repeated motion only shows the robot's repeatability."
    )
    CHECK = (
        "Run `dynident check` on the configuration: it checks signs, gains, units and gravity. Then look at the "
        "largest residuals in the report; other friction terms or less noise in the motion may help."
    )
    TORQUE_COLUMN = "Check that the right torque column is named, and was recorded."
    LONGER_TRAINING = "Record a longer training motion that covers the speeds and accelerations of the held-out one."
    EXCITE = "Record a training motion in which every joint moves: at several speeds, and in many poses of the others."
    CONSISTENT_FIT = (
        "Fit with `estimator: {kind: consistent}`: bodies and friction are then physically consistent, and the "
        "mass matrix is positive definite."
    )
    SIMULATE = (
        "Add `simulation:` to the configuration, with the controller where it is known, else `kind: measured_torque`."
    )
    CONTROLLER_LOOP = (
        "Simulate in closed loop with the controller, where it is known: driven by torque alone, any model drifts."
    )


class ExcitingMotion(StrEnum):
    """How a joint should move to excite a parameter, which acts through velocity, position or acceleration."""

    CONSTANT_SPEEDS = "move {joint} at several constant speeds in both directions"
    MANY_POSES = "move {joint} slowly to and fro in many poses"
    ACCELERATE = "accelerate {joint} harder, in several poses of the others"


class NextStep(Statement, TaggedUnion):
    """Base of the next steps that follow from the data, besides remedies and unexcited base parameters.

    ``gain``: by how many points (%) the unfiltered error of the held-out log where it is largest (without one, of the
    training log) may fall, None where the data do not tell.
    """

    gain: float | None = field(default=None, kw_only=True)

    def gain_text(self, how: str = "about") -> str:
        """Return what the step may gain as a sentence, an empty text where that is unknown."""
        if self.gain is None:
            return ""
        size = f"{how} {self.gain:.2g}" if self.gain >= MIN_REPORTED_GAIN else f"less than {MIN_REPORTED_GAIN:g}"
        return f" This may lower the torque error by {size} points."


class Sharpen(NextStep):
    """Record a motion that excites a ``parameter`` better.

    Its ``value`` has the standard error ``std`` (both in SI units, ``unit``), which is ``share`` % of the torque.
    ``joint`` is the one to move, None for all of them. At ``faster`` times the speed of the training the parameter
    would be known well, None where speed does not show it better. The gain is that of knowing it exactly.
    """

    parameter: str
    value: float
    std: float
    share: float
    excitation: ExcitingMotion
    joint: str | None
    faster: float | None = None
    unit: str = ""

    def __str__(self) -> str:
        motion = self.excitation.format(joint=self.joint or "the joints")
        speed = f", up to {self.faster:.2g} times the speed" if self.faster is not None and self.faster > 1.05 else ""
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        return (
            f"{self.parameter} is {self.value:.3g} +- {self.std:.2g}{unit} (one standard error, {rough(self.share)} of "
            f"the torque): {motion}{speed}.{self.gain_text('at most')}"
        )


class SlowReversals(NextStep):
    """Record slow motion of the ``joints`` through zero speed, or smooth their Coulomb friction.

    Below these ``speeds`` (rad/s, m/s) the residual is larger than elsewhere. ``terms_chosen`` tells that
    friction and minimum speed are the best of those that were tried. The gain is that of a residual no larger
    there.
    """

    joints: tuple[str, ...]
    speeds: tuple[float, ...] = ()
    terms_chosen: bool = False

    def __str__(self) -> str:
        below = f" (below {', '.join(f'{speed:.2g}' for speed in self.speeds)} rad/s or m/s)" if self.speeds else ""
        alternative = "" if self.terms_chosen else ", or try `coulomb_width` or `min_speed`"
        advice = f"{', '.join(self.joints)}: record slow motion through zero speed{alternative}"
        return f"{advice}{below}." + self.gain_text("at most")


class CheckRipple(NextStep):
    """Record constant speeds of the ``joints`` to see whether the ripple, of these ``frequencies`` (Hz), follows the
    position.

    The gain is that of a model of the whole ripple.
    """

    joints: tuple[str, ...]
    frequencies: tuple[float, ...] = ()

    def __str__(self) -> str:
        ripple = f"ripple ({', '.join(f'{x:.3g}' for x in self.frequencies)} Hz)" if self.frequencies else "ripple"
        advice = f"{', '.join(self.joints)}: move at constant speeds, to see whether the {ripple} follows the position."
        return advice + self.gain_text("at most")


class SetRight(NextStep):
    """Correct what a ``finding`` of the checks says of the robot or its model.

    The gain is that of the share that it has in what no noise explains, in training.
    """

    finding: Finding

    def __str__(self) -> str:
        finding = self.finding
        where = ": ".join(filter(None, (finding.source, finding.joint)))
        return f"{where}: {finding.message.remedy}".removeprefix(": ") + self.gain_text()


class HoldOutFaster(NextStep):
    """Record a held-out motion ``times`` as fast as the fastest one, as fast as the training, for a better verdict."""

    times: float

    def __str__(self) -> str:
        return (
            f"Record a held-out motion {self.times:.2g} times as fast, on other paths: a slow one shows little of the "
            "inertias."
        )


class LeaveOut(NextStep):
    """Leave the seconds from ``start`` to ``stop`` out of a training ``log``.

    Predicted from all others, they have a mean squared residual ``ratio`` times that of the others. The gain is
    cross-validated on these.
    """

    log: str
    start: float
    stop: float
    ratio: float

    def __str__(self) -> str:
        return (
            f"{self.log}: leave {_stretch(self)} out of the training (`window`). Predicted from the other samples, "
            f"their squared residual is {self.ratio:.2g} times that of the others. Did the robot touch "
            f"something?{self.gain_text()}"
        )


class Cover(NextStep):
    """Record training motion in which a ``joint`` is ``faster`` times as fast as now, up to ``speed`` (rad/s, m/s).

    Held-out motion is beyond the speeds and accelerations of the training, above all from ``start`` to ``stop`` (s) of
    a ``log``. The gain is that of an error there as it is on the rest of that log.
    """

    log: str
    start: float
    stop: float
    joint: str
    faster: float
    speed: float

    def __str__(self) -> str:
        return (
            f"{self.joint}: record a training motion {self.faster:.2g} times as fast, up to {self.speed:.2g} rad/s or "
            f"m/s: the motion of {self.log} exceeds it, most of all from {_stretch(self)}.{self.gain_text()}"
        )


class MoreRecordings(NextStep):
    """Record further motions and fit all together: ``logs`` are fitted now, and twice as many have half the variance.

    The gain is that of half the variance which the errors of the parameters have in the torque of the log judged.
    """

    logs: int

    def __str__(self) -> str:
        motions = "a second motion" if self.logs == 1 else f"{self.logs} further motions"
        return (
            f"Record {motions}, as fast as the training, and fit all together (`train`): twice as many recordings "
            f"halve the variance of the parameters.{self.gain_text()}"
        )


def _stretch(step: LeaveOut | Cover) -> str:
    return f"{number(step.start, 3)} to {number(step.stop, 3)} s"


MIN_REPORTED_GAIN = 0.01  # points: smaller gains are not given
MIN_GAIN_SHARE = 0.01  # share of the error that a step must gain


def judged_log(identification: Identification) -> LogValidation:
    """Return the held-out log with the largest unfiltered error; the training log, where none was held out."""
    return max(
        identification.of_role("validation") or identification.validations,
        key=lambda log: np.nan_to_num(log.errors.relative_error, nan=-1.0),
    )


def excess_squares(log: LogValidation) -> dict[str, float]:
    """Return the mean squared residual of each joint beside the noise of the sensors."""
    noise = log.errors.sensor_noise
    return {joint: max(size**2 - noise.get(joint, 0.0) ** 2, 0.0) for joint, size in log.errors.rmse.items()}


def gain_points(log: LogValidation, removed: Mapping[str, float]) -> float | None:
    """Return by how many points the error of a log may fall.

    The mean squared residuals of the joints fall by ``removed`` ((N m)^2, N^2), to no less than the noise of the
    sensors. None where this is nothing, or no number.
    """
    errors, excess = log.errors, excess_squares(log)
    reduction = sum(min(max(removed.get(joint, 0.0), 0.0), size) for joint, size in excess.items())
    total = sum(size**2 for size in errors.rmse.values())
    if not (total > 0 and reduction > 0 and np.isfinite(errors.relative_error)):
        return None
    return float(errors.relative_error * (1.0 - np.sqrt(1.0 - reduction / total)))
