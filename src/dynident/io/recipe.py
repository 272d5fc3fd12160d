"""Turns the settings of a configuration into the frozen parts that they name."""

from __future__ import annotations

from typing import assert_never

from dynident.estimators import Consistent, Estimator, LeastSquares, MaximumLikelihood
from dynident.identify import Recipe
from dynident.io.settings import (
    ButterworthSettings,
    Config,
    ConsistentSettings,
    DifferenceSettings,
    LeastSquaresSettings,
    MaximumLikelihoodSettings,
    RobotSettings,
    SplineSettings,
    TorqueInputSettings,
)
from dynident.regression import Parallel
from dynident.smoothers import Butterworth, Difference, Smoother, Spline
from dynident.splines import GCV, REML, Constraint, Fixed, Interpolation, Rule

__all__ = ["build_recipe"]


def build_recipe(config: Config) -> Recipe:
    """Return smoother, estimator and parallel filter as configured; ConfigError where their values do not fit."""
    given = config.parallel
    parallel = None if given is None else Parallel(given.decimate, given.cutoff, given.order)
    lean = isinstance(config.model, RobotSettings) and config.model.lean == "estimate"
    restart = config.simulation.restart if isinstance(config.simulation, TorqueInputSettings) else None
    smoother, estimator = _smoother(config.smoother), _estimator(config.estimator)
    return Recipe(smoother, estimator, parallel, config.slow, config.delay, lean, restart)


def _estimator(settings: LeastSquaresSettings | ConsistentSettings | MaximumLikelihoodSettings) -> Estimator:
    match settings:
        case LeastSquaresSettings():
            return LeastSquares(settings.tolerance, settings.weights)
        case ConsistentSettings():
            given = {name: getattr(settings, name) for name in type(settings).model_fields if name != "kind"}
            return Consistent(**given)
        case MaximumLikelihoodSettings():
            return MaximumLikelihood(
                settings.start, settings.spacing, settings.steps, settings.huber, profile=settings.profile
            )
        case _:
            assert_never(settings)


FACTORS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)  # times the noise estimate, to choose from


def _smoother(
    settings: SplineSettings | DifferenceSettings | ButterworthSettings,
) -> Smoother | tuple[Smoother, ...]:
    match settings:
        case SplineSettings(rule="torque"):
            return tuple(Spline(Constraint(), settings.sigma, settings.ends, factor) for factor in FACTORS)
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
        case "constraint" | "torque":
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
