"""Turns the settings of a configuration into the frozen parts that they name."""

from __future__ import annotations

from dynident.identification import Recipe
from dynident.io.parts import built
from dynident.io.settings import Config, RobotSettings
from dynident.io.simulation_settings import TorqueInputSettings
from dynident.regression import ParallelFilter

__all__ = ["build_recipe"]


def build_recipe(config: Config) -> Recipe:
    """Return smoother, estimator and parallel filter as configured; ConfigError where their values do not fit."""
    given = config.filter
    parallel_filter = None if given is None else ParallelFilter(given.decimate, given.cutoff, given.order)
    tilt = config.model.base_tilt if isinstance(config.model, RobotSettings) else "none"
    restart = config.simulation.restart if isinstance(config.simulation, TorqueInputSettings) else None
    smoother, estimator = built(config.smoother), built(config.estimator)
    return Recipe(
        smoother,
        estimator,
        parallel_filter,
        config.min_speed,
        config.delay,
        None if tilt == "none" else tilt,
        restart,
        config.outliers,
        config.rests,
        "auto" if isinstance(config.model, RobotSettings) and config.model.chooses_terms else None,
        config.model.proposed if isinstance(config.model, RobotSettings) else (),
        config.unfitted,
    )
