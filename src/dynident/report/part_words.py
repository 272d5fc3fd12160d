"""Smoothers, estimators and filters in words; one small function per type, those of the user by name and settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import singledispatch
from typing import Any

from dynident.estimators import (
    AugmentedKalman,
    Didim,
    GeneralisedLeastSquares,
    InstrumentalVariables,
    LeastSquares,
    MaximumLikelihood,
    OutputError,
    PhysicallyConsistent,
    Ridge,
    RobustLeastSquares,
    TotalLeastSquares,
    WeightedLeastSquares,
)
from dynident.regression import ParallelFilter
from dynident.report.words import short
from dynident.smoothers import (
    Butterworth,
    Difference,
    FourierSeries,
    KalmanSmoother,
    SavitzkyGolay,
    Spline,
    TimeShifted,
)
from dynident.splines import GCV, REML, Constraint, Fixed, Interpolation

__all__ = ["part_words", "settings_words", "value_words"]

FEW = 8  # entries of a setting that are listed


@singledispatch
def part_words(part: object) -> str:
    """Return a part that can be exchanged in words: one of the user by the name of its class and its settings."""
    return settings_words(type(part).__name__, part)


def settings_words(name: str, part: object, known: tuple[str, ...] = ()) -> str:
    """Return a name with the settings of a part that differ from their defaults, but for those in ``known``."""
    if not is_dataclass(part):
        return name
    shown = [one for one in fields(part) if one.init and one.name not in known and _differs(part, one)]
    return ", ".join([name, *(f"{one.name.replace('_', ' ')} {value_words(getattr(part, one.name))}" for one in shown)])


def _differs(part: Any, one: Field[Any]) -> bool:
    usual = one.default if one.default_factory is MISSING else one.default_factory()
    return bool(getattr(part, one.name) != usual)


def value_words(value: object) -> str:
    """Return a setting as text: numbers to four digits, lists and mappings in brackets."""
    if isinstance(value, bool) or value is None:
        return {True: "on", False: "off", None: "none"}[value]
    if isinstance(value, Mapping):
        return _listed([f"{key} {value_words(one)}" for key, one in value.items()])
    if isinstance(value, tuple | list):
        return _listed([value_words(one) for one in value])
    if isinstance(value, int | float):
        return short(float(value), 4)
    return part_words(value) if is_dataclass(value) else f"{value}"


def _listed(texts: list[str]) -> str:
    return f"({', '.join(texts[:FEW])}{', ...' * (len(texts) > FEW)})"


@part_words.register
def _(part: Spline) -> str:
    rule, given = part.rule, [f"noise {value_words(part.sigma)} rad or m"] if part.sigma is not None else []
    usual = part.factor == 1.0
    if isinstance(rule, Constraint):
        how = _degree(rule, part.factor)
    else:
        names = {GCV: "by generalised cross-validation", REML: "by restricted maximum likelihood"}
        how = names.get(type(rule), settings_words(type(rule).__name__, rule))
        given += [] if usual or isinstance(rule, Fixed) else [f"{value_words(part.factor)} times the noise"]
    if isinstance(rule, Interpolation):
        return ", ".join(["interpolating spline", *_ends(part)])
    if isinstance(rule, Fixed):
        how = "p" if rule.p is not None else "lam"
        how = f"{how} {value_words(getattr(rule, how))}"
    return ", ".join([f"smoothing spline, {how}", *given, *_ends(part)])


def _degree(rule: Constraint, factor: object) -> str:
    """Return how much a spline smooths: S by the number of samples and the noise of the positions."""
    if rule.S is not None:
        times = "" if factor == 1.0 else f", {value_words(factor)} times the noise"
        return f"S = {value_words(rule.S)}{times}"
    if isinstance(factor, int | float):
        return "S = n" if factor == 1.0 else f"S = {short(factor**2)} n ({short(factor)} times the noise)"
    return f"S = n at {value_words(factor)} times the noise"


def _ends(part: Spline) -> list[str]:
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
        given = part.intensity is not None
        how += [f"intensity {value_words(part.intensity)}" if given else "the rest by maximum likelihood"]
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
    kept = f", one of {part.decimate} samples kept" if part.decimate > 1 else ""
    return f"low-pass of order {part.order} at {cutoff}{kept}"
