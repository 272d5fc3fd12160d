"""Turns the settings of a configuration into the frozen parts that they name."""

from __future__ import annotations

from typing import assert_never

from dynident.estimators import LeastSquares
from dynident.identify import Recipe
from dynident.io.settings import ButterworthSettings, Config, DifferenceSettings, SplineSettings
from dynident.regression import Parallel
from dynident.smoothers import Butterworth, Difference, Smoother, Spline
from dynident.splines import GCV, REML, Constraint, Fixed, Interpolation, Rule

__all__ = ["build_recipe"]


def build_recipe(config: Config) -> Recipe:
    """Return smoother, estimator and parallel filter as configured; ConfigError where their values do not fit."""
    given = config.parallel
    parallel = None if given is None else Parallel(given.decimate, given.cutoff, given.order)
    return Recipe(_smoother(config.smoother), LeastSquares(config.estimator.tolerance), parallel)


def _smoother(settings: SplineSettings | DifferenceSettings | ButterworthSettings) -> Smoother:
    match settings:
        case SplineSettings():
            return Spline(_rule(settings), settings.sigma, settings.ends)
        case DifferenceSettings():
            return Difference(settings.scheme)
        case ButterworthSettings():
            return Butterworth(settings.orders, settings.cutoffs, settings.settle)
        case _:
            assert_never(settings)


def _rule(settings: SplineSettings) -> Rule:
    match settings.rule:
        case "constraint":
            return Constraint(settings.S)
        case "fixed":
            return Fixed(settings.p, settings.lam)
        case "gcv":
            return GCV()
        case "reml":
            return REML()
        case "interpolate":
            return Interpolation()
        case _:
            assert_never(settings.rule)
