"""The notes of an estimate: what the data do not determine, how an iteration ended, how the data were changed."""

from __future__ import annotations

from typing import ClassVar

from dynident.runtime import Note, Severity, Use, WordedEnum, count, percent, short

MAX_ERROR_PERCENT = 50.0  # %


class FirstModel(WordedEnum):
    """The first model of a simulation or a filter."""

    SMOOTHED = "smoothed", "least squares of a smoothing spline"
    KALMAN = "kalman", "least squares of a Kalman smoother"
    CONSISTENT = "consistent", "the physically consistent fit"
    INSTRUMENTS = "instruments", "instrumental variables"
    NOMINAL = "nominal", "the values of the robot file"
    MASS = "mass", "least squares with a positive definite mass matrix"


class Undetermined(Note):
    """Base of the notes on a deficient rank, which is normal for inertial parameters: no motion determines all."""


class Unsettled(Note):
    """Base of the notes on an iteration that did not converge."""


class RankDeficient(Undetermined):
    """The data determine ``rank`` combinations of so many ``parameters``.

    ``without_effect`` names those with no effect on the torque, ``tied`` the groups of which only combinations are
    identifiable; both are empty where the estimator does not compute them.
    """

    rank: int
    parameters: int
    without_effect: tuple[str, ...] = ()
    tied: tuple[tuple[str, ...], ...] = ()

    def __str__(self) -> str:
        parts = [f"rank {self.rank} of {self.parameters}"]
        if self.without_effect:
            listed = ", ".join(self.without_effect)
            parts.append(f"no effect on the torque in these data: {listed} (move the joints that excite them)")
        parts += [
            f"only combinations are identifiable: {', '.join(names)} (remove or fix all but one, or excite them "
            "differently)"
            for names in self.tied
        ]
        return "; ".join(parts)


class NotAlone(Undetermined):
    """Parameters that the data do not determine by themselves."""

    names: tuple[str, ...]

    def __str__(self) -> str:
        return f"not determined individually: {', '.join(self.names)}"


class NotByData(Undetermined):
    """``count`` parameters are not determined by the data alone."""

    count: int
    how: ClassVar[str] = "not determined by the data alone"

    def __str__(self) -> str:
        return f"{count(self.count, 'parameter')} {'is' if self.count == 1 else 'are'} {self.how}"


class DecidedByPrior(NotByData):
    """``count`` parameters are determined by the prior where the data do not determine them."""

    how = "determined by the prior, not by the data"


class NotIdentifiable(NotByData):
    """``count`` parameters are determined by neither data nor prior."""

    how = "determined by neither data nor prior"


class DrawnToPrior(Note):
    """The estimate is drawn to the prior with a ``strength`` that cross-validation chose."""

    severity = Severity.INFO
    strength: float

    def __str__(self) -> str:
        return f"regularised towards the prior with strength {short(self.strength, 2)}, chosen by cross-validation"


class ErrorsInRegressor(Note):
    """Along one direction, errors make up ``percent`` of what the regressor shows (its sum of squares).

    The direction is mostly that of ``parameter``. The estimate there rests on the stated size of the errors;
    where the share is more than half, the parameters are unfit for any use.
    """

    parameter: str
    percent: float

    @property
    def forbidden(self) -> Use | None:
        """Any use, where there is more error than motion."""
        return Use.CONTROL if self.percent > MAX_ERROR_PERCENT else None

    def __str__(self) -> str:
        return (
            f"along one direction, mostly that of {self.parameter}, noise of the motion is {percent(self.percent)} of "
            "the information: the estimate there depends on the stated size of this noise"
        )


class HeldByConstraints(Note):
    """Constraints hold base parameters far from where the data alone would have them: formula, standard errors."""

    severity = Severity.INFO
    moved: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        listed = ", ".join(f"{name} ({size:.1f})" for name, size in self.moved)
        return (
            "constraints hold these base parameters more than 3 standard errors (in brackets) from least squares: "
            f"{listed}; the model lacks an effect, a sensor or a gain is off, or a limit is wrong. Their standard "
            "errors count this"
        )


class ConstraintsCostly(Note):
    """The constraints raise the weighted training error (%) from ``free`` to ``error``, mostly those of ``family``."""

    family: str
    error: float
    free: float

    def __str__(self) -> str:
        return (
            f"the constraints, most of all {self.family}, raise the training error to {percent(self.error)}, where "
            f"without them it is {percent(self.free)}; look for a wrong sign, gain or axis, or a term that the model "
            "lacks"
        )


class MotionCorrected(Note):
    """Errors of the smoothed motion would bias a base ``parameter`` by ``size`` standard errors; they are corrected."""

    severity = Severity.INFO
    parameter: str
    size: float

    def __str__(self) -> str:
        return (
            f"smoothing and the noise left in the motion bias least squares, {self.parameter} by "
            f"{short(self.size, 2)} standard errors; predicted by a second smoothing with noise, this bias was "
            "subtracted"
        )


class LimitedByMotion(Note):
    """The remaining bias by errors of the smoothed motion dominates some standard errors.

    That is so for ``limited`` of ``all`` base parameters, above all for ``parameter``.
    """

    severity = Severity.INFO
    parameter: str
    limited: int
    all: int

    def __str__(self) -> str:
        return (
            f"a longer recording does not help {self.limited} of {self.all} base parameters, {self.parameter} above "
            "all: most of their standard errors is what errors of the smoothed motion leave; positions with less "
            "noise help"
        )


class MotionTooNoisy(Note):
    """Errors of the smoothed motion bias a base ``parameter`` by ``size`` standard errors: too much to correct."""

    parameter: str
    size: float

    def __str__(self) -> str:
        return (
            f"standard errors are too small: smoothing and the noise left in the motion bias {self.parameter} by "
            f"about {short(self.size, 2)} of them, too much to be corrected; use the estimator maximum_likelihood"
        )


class PriorApproached(Undetermined):
    """The barrier method stopped at a duality ``gap`` before the parameters nearest to the prior."""

    gap: float

    def __str__(self) -> str:
        return f"the prior was not reached exactly: the barrier method stopped at a duality gap of {self.gap:.1e}"


class NotConverged(Unsettled):
    """The iteration stopped after ``iterations`` steps; the log-likelihood may still increase by ``gain``."""

    iterations: int
    gain: float

    def __str__(self) -> str:
        hint = f"the likelihood may still increase by a factor of exp({short(self.gain, 2)})"
        return f"not converged after {self.iterations} steps: {hint}"


class StillMoving(Unsettled):
    """After so many ``iterations`` the parameters still move, by ``moved`` standard errors of all together.

    Where a simulation has failed, the ``reason`` says why.
    """

    iterations: int
    moved: float
    reason: str = ""

    def __str__(self) -> str:
        return (
            f"not settled after {count(self.iterations, 'step')}: the last one moved the parameters by "
            f"{short(self.moved, 2)} standard errors" + f"; {self.reason}" * bool(self.reason)
        )


class Downweighted(Note):
    """By joint, the share of the torques that count less than half, because they look wrong."""

    severity = Severity.INFO
    joints: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        listed = ", ".join(f"{name} {percent(100 * share)}" for name, share in self.joints)
        return f"torques that look wrong count less than half: {listed} of them"


class Failed(Unsettled):
    """Maximum likelihood failed for a ``reason`` (the error's message), and the estimate is its start."""

    reason: str

    def __str__(self) -> str:
        return f"maximum likelihood failed, so this is its least-squares start: {self.reason}"


class NotWhite(Note):
    """The torque residuals have a ``correlation`` between neighbouring samples: they are more than noise."""

    correlation: float

    def __str__(self) -> str:
        return (
            f"the torque residuals are not white (correlation between neighbouring samples {self.correlation:z.2f}): "
            "they are more than noise, so compare with least squares on held-out motion"
        )


class ScatterLarger(Note):
    """The standard error of a ``parameter`` is ``ratio`` times as large by the scatter of the residuals over time."""

    parameter: str
    ratio: float

    def __str__(self) -> str:
        return (
            "standard errors assume white residuals; from the scatter of the residuals over time, that of "
            f"{self.parameter} is {short(self.ratio, 2)} times as large"
        )


class MovingStart(Note):
    """The recordings do not start from rest, by a likelihood ratio test with this ``p_value``."""

    severity = Severity.INFO
    p_value: float

    def __str__(self) -> str:
        return f"the recordings do not start from rest (likelihood ratio test, p = {self.p_value:.1e})"


class Averaged(Note):
    """Averages of ``group`` neighbouring samples were used."""

    severity = Severity.INFO
    group: int

    def __str__(self) -> str:
        return f"each {self.group} neighbouring samples were averaged"


class SmoothSigns(Note):
    """The sign of the velocity in friction was replaced by tanh(dq / width), with these ``widths`` (rad/s or m/s)."""

    severity = Severity.INFO
    widths: tuple[float, ...]

    def __str__(self) -> str:
        listed = ", ".join(f"{short(x, 2)}" for x in self.widths)
        return f"the sign of the velocity in friction was replaced by tanh(dq / width), with widths {listed}"


class StartedElsewhere(Note):
    """The iteration began with another first model, as that of least squares cannot be simulated, or is farther off."""

    severity = Severity.INFO
    start: FirstModel

    def __str__(self) -> str:
        return f"least squares fails or is worse in simulation, so the iteration started from {self.start.words}"


class StillColoured(Note):
    """The whitened residual of a ``joint`` has a ``correlation`` over time: no such noise describes it."""

    joint: str
    correlation: float

    def __str__(self) -> str:
        return (
            f"after whitening, the torque residual of {self.joint} is still correlated over time "
            f"({self.correlation:z.2f}): it is more than autoregressive noise, so compare with least squares on "
            "held-out motion"
        )


class WhiteningCostly(Note):
    """The fit to whitened rows leaves ``ratio`` times as much of the torque of a ``joint`` as least squares.

    Where such noise does not do that by ``chance``, what counts as noise there follows the motion, and is what the
    model lacks: the parameters may be many standard errors off.
    """

    joint: str
    ratio: float
    chance: bool = False

    @property
    def forbidden(self) -> Use | None:
        """Simulation, where chance does not explain it."""
        return None if self.chance else Use.SIMULATION

    def __str__(self) -> str:
        because = (
            "such noise alone does not: it is what the model lacks, so that parameters may be many standard errors "
            "off, and least squares predicts better"
        )
        if self.chance:
            because = (
                "slow noise may do that, and so may what the model lacks: compare with least squares on held-out motion"
            )
        return (
            f"the fit to whitened rows leaves {short(self.ratio, 3)} times as much of the torque of {self.joint} as "
            f"least squares; {because}"
        )
