"""What the parts of an identification's report share: its logs by role, numbers as text, and points per curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import singledispatch
from math import inf
from typing import TYPE_CHECKING, Any

from dynident.estimators import (
    AugmentedKalman,
    Didim,
    GeneralisedLeastSquares,
    InstrumentalVariables,
    LeastSquares,
    OutputError,
    PhysicallyConsistent,
    Ridge,
    RobustLeastSquares,
    TotalLeastSquares,
    WeightedLeastSquares,
)
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.motion.smoothers import (
    Butterworth,
    Difference,
    FourierSeries,
    KalmanSmoother,
    SavitzkyGolay,
    Spline,
    TimeShifted,
)
from dynident.motion.splines import GCV, REML, Constraint, Fixed, Interpolation
from dynident.regression import GroupKind, ParallelFilter
from dynident.report.figures import points_per_curve
from dynident.report.page import number

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.validation import LogValidation

ROLES = {"train": "training", "validation": "held out"}
ROUNDING = 1e-12
CURVES_PER_JOINT = 11  # of a log and joint: torques, motion, free simulation
KINDS = {
    GroupKind.FRICTION: "friction of {}",
    GroupKind.PAYLOAD: "payload at {}",
    GroupKind.OFFSET: "offset of {}",
    GroupKind.RIPPLE: "ripple of {}",
    GroupKind.RESIDUAL: "torque that the model leaves at {}",
}

MAX_LISTED_ENTRIES = 8  # entries of a setting that are listed


def logs_of(identification: Identification, role: str) -> list[LogValidation]:
    """Return the logs of a role, "train" or "validation"."""
    return [log for log in identification.validations if log.role == role]


def motion_known(identification: Identification) -> str:
    """Return whether the standard errors count the errors of the motion, and what they do not count, as sentences."""
    if identification.estimate.information is not None:
        return "They count the errors of the motion, too."
    if identification.errors.allows_correlation:
        return (
            "They count the noise left in the motion, but not what the model lacks: the true uncertainty is larger "
            "where the torque error is larger than the noise."
        )
    return (
        "They take the motion as exactly known: the true uncertainty is larger, especially where the torque error is "
        "large."
    )


def log_labels(identification: Identification) -> list[tuple[str, int]]:
    """Return the logs as a reader chooses among them: label and index in ``validations``; held-out ones come first."""
    logs = identification.validations
    order = sorted(range(len(logs)), key=lambda k: logs[k].role == "train")
    return [(label_of(logs[k]), k) for k in order]


def label_of(log: LogValidation) -> str:
    """Return the label of a log: its name and role."""
    return f"{log.name} ({ROLES.get(log.role, log.role)})"


def count(number_of: int, noun: str) -> str:
    """Word a count, such as "1 log" or "2 logs"."""
    return f"{number_of} {noun}{'' if number_of == 1 else 's'}"


def day(stamp: str) -> str:
    """Word a time that is given in ISO 8601, such as "2026-11-22 14:05 UTC"; "" stays."""
    return f"{stamp[:10]} {stamp[11:16]} UTC" if stamp else ""


def percent(value: float, digits: int = 3) -> str:
    """Format a share (%) to ``digits`` significant digits: never "1e+02 %" for 100 %."""
    return f"{short(value, digits)} %"


def rough(value: float) -> str:
    """Format a share (%) to two digits, from 10 % on to whole percents."""
    return percent(value, 2) if value < 10 else f"{value:.0f} %"


def shorten(text: str, max_length: int | None) -> str:
    """Return a text cut at a word within ``max_length`` characters."""
    return text if max_length is None or len(text) <= max_length else f"{text[:max_length].rsplit(' ', 1)[0]} …"


def short(value: float, digits: int = 3) -> str:
    """Format a number to ``digits`` significant digits: never 190 as "1.9e+02", and 0.5 without trailing zeros."""
    text = f"{value:.{digits}g}"
    return number(value, digits) if "e" in text else text


def tiny(value: float, digits: int = 2) -> str:
    """Format a number; one that is no more than rounding is given as below it."""
    return f"below {ROUNDING:g}" if 0 < abs(value) < ROUNDING else number(value, digits)


def huge(value: float, digits: int = 2) -> str:
    """Format a ratio; one that rounding makes of infinity is given as above a limit."""
    return f"above {1 / ROUNDING:g}" if 1 / ROUNDING < value < inf else number(value, digits)


def points(identification: Identification) -> int:
    """Return the number of points of each curve such that the page stays small."""
    return points_per_curve(CURVES_PER_JOINT * len(identification.validations) * len(identification.model.joints))


def kind_words(kind: GroupKind, joint: str) -> str:
    """Return what can change in words, such as "friction of elbow"."""
    return KINDS[kind].format(joint)


def signed_text(value: float) -> str:
    """Return the size of a change with its sign, in three digits."""
    return f"{'+' if value > 0 else ''}{number(float(value), 3)}"


@singledispatch
def part_words(part: object) -> str:
    """Return an exchangeable part as text: one of the user by the name of its class and its settings."""
    return settings_words(type(part).__name__, part)


def settings_words(name: str, part: object, skip: tuple[str, ...] = ()) -> str:
    """Return a name with the settings of a part that differ from their defaults, without those in ``skip``."""
    if not is_dataclass(part):
        return name
    changed = [field for field in fields(part) if field.init and field.name not in skip and _is_changed(part, field)]
    return ", ".join(
        [name, *(f"{field.name.replace('_', ' ')} {value_words(getattr(part, field.name))}" for field in changed)]
    )


def _is_changed(part: Any, field: Field[Any]) -> bool:
    default = field.default if field.default_factory is MISSING else field.default_factory()
    return bool(getattr(part, field.name) != default)


def value_words(value: object) -> str:
    """Return a setting as text: numbers to four digits, lists and mappings in brackets."""
    if isinstance(value, bool) or value is None:
        return {True: "on", False: "off", None: "none"}[value]
    if isinstance(value, Mapping):
        return _list_entries([f"{key} {value_words(entry)}" for key, entry in value.items()])
    if isinstance(value, tuple | list):
        return _list_entries([value_words(entry) for entry in value])
    if isinstance(value, int | float):
        return short(float(value), 4)
    return part_words(value) if is_dataclass(value) else f"{value}"


def _list_entries(texts: list[str]) -> str:
    return f"({', '.join(texts[:MAX_LISTED_ENTRIES])}{', ...' * (len(texts) > MAX_LISTED_ENTRIES)})"


@part_words.register
def _(part: Spline) -> str:
    rule, extras = part.rule, [f"noise {value_words(part.sigma)} rad or m"] if part.sigma is not None else []
    is_default = part.factor == 1.0
    if isinstance(rule, Constraint):
        how = _smoothing_degree(rule, part.factor)
    else:
        names = {GCV: "by generalised cross-validation", REML: "by restricted maximum likelihood"}
        how = names.get(type(rule), settings_words(type(rule).__name__, rule))
        extras += [] if is_default or isinstance(rule, Fixed) else [f"{value_words(part.factor)} times the noise"]
    if isinstance(rule, Interpolation):
        return ", ".join(["interpolating spline", *_end_words(part)])
    if isinstance(rule, Fixed):
        how = "p" if rule.p is not None else "lam"
        how = f"{how} {value_words(getattr(rule, how))}"
    return ", ".join([f"smoothing spline, {how}", *extras, *_end_words(part)])


def _smoothing_degree(rule: Constraint, factor: object) -> str:
    """Return how much a spline smooths: S by the number of samples and the noise of the positions."""
    if rule.S is not None:
        times = "" if factor == 1.0 else f", {value_words(factor)} times the noise"
        return f"S = {value_words(rule.S)}{times}"
    if isinstance(factor, int | float):
        return "S = n" if factor == 1.0 else f"S = {short(factor**2)} n ({short(factor)} times the noise)"
    return f"S = n at {value_words(factor)} times the noise"


def _end_words(part: Spline) -> list[str]:
    return [] if part.ends == 6.0 else [f"{part.ends:g} bandwidths left out at the ends"]


@part_words.register
def _(part: Butterworth) -> str:
    return settings_words(part.method, part, ("orders", "cutoffs"))


@part_words.register
def _(part: Difference) -> str:
    return part.method


@part_words.register
def _(part: KalmanSmoother) -> str:
    how = ["by maximum likelihood"]
    if part.sigma is not None:
        how = [f"noise {value_words(part.sigma)} rad or m"]
        is_given = part.intensity is not None
        how += [f"intensity {value_words(part.intensity)}" if is_given else "the rest by maximum likelihood"]
    name = ", ".join([f"Kalman smoother of order {part.order}", *how])
    return settings_words(name, part, ("order", "sigma", "intensity"))


@part_words.register
def _(part: SavitzkyGolay) -> str:
    words = f"Savitzky-Golay polynomials of order {part.order}"
    if part.window is not None:
        return f"{words}, window{'s' * isinstance(part.window, Mapping)} {value_words(part.window)} s"
    times = f", {value_words(part.factor)} times the window best for ddq"
    return words + times * (part.factor != 1.0)


@part_words.register
def _(part: FourierSeries) -> str:
    return settings_words(part.method, part, ("period",))


@part_words.register
def _(part: TimeShifted) -> str:
    return f"{part_words(part.smoother)}, shifted by {short(1e3 * part.time_offset)} ms"


@part_words.register
def _(part: LeastSquares) -> str:
    name = "least squares" + ", weighted by joint" * (part.weights == "per_joint")
    return settings_words(name, part, ("weights",))


@part_words.register
def _(part: WeightedLeastSquares) -> str:
    return settings_words("least squares, weighted by the noise of all joints", part)


@part_words.register
def _(part: GeneralisedLeastSquares) -> str:
    return settings_words("generalised least squares, with autoregressive noise", part)


@part_words.register
def _(part: PhysicallyConsistent) -> str:
    return settings_words("physically consistent least squares", part)


@part_words.register
def _(part: InstrumentalVariables) -> str:
    return settings_words("instrumental variables", part)


@part_words.register
def _(part: Didim) -> str:
    return settings_words("DIDIM, the torque of the simulated loop", part)


@part_words.register
def _(part: OutputError) -> str:
    where = {"auto": "", "closed": " in the loop", "open": ", driven by the torque"}[part.loop]
    return settings_words("output error of simulated positions" + where, part, ("loop",))


@part_words.register
def _(part: MaximumLikelihood) -> str:
    return settings_words("maximum likelihood", part)


@part_words.register
def _(part: RobustLeastSquares) -> str:
    name = {"huber": "Huber's", "tukey": "Tukey's"}[part.loss]
    return settings_words(f"robust least squares, {name} weights", part, ("loss",))


@part_words.register
def _(part: Ridge) -> str:
    return settings_words("ridge regression", part)


@part_words.register
def _(part: TotalLeastSquares) -> str:
    return settings_words("total least squares", part)


@part_words.register
def _(part: AugmentedKalman) -> str:
    name = {"extended": "extended Kalman filter", "sigma_point": "sigma-point Kalman filter"}[part.method]
    return settings_words(f"{name} of motion and parameters", part, ("method",))


@part_words.register
def _(part: ParallelFilter) -> str:
    cutoff = "0.8 of half the decimated rate" if part.cutoff is None else f"{part.cutoff:g} Hz"
    decimation = f", one of {part.decimate} samples kept" if part.decimate > 1 else ""
    return f"low-pass of order {part.order} at {cutoff}{decimation}"
