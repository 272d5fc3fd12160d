"""Recordings simulated with a model: controllers, the steps, and their exact derivatives."""

from dynident.simulation.controllers import PD, PID, CascadePD, Function, HasSlopes, Slopes
from dynident.simulation.failure import Broken, Failure, RunsAway, Singular
from dynident.simulation.run import Simulated, simulated
from dynident.simulation.sensitivity import Sensitivity, sensitivities

__all__ = [
    "PD",
    "PID",
    "Broken",
    "CascadePD",
    "Failure",
    "Function",
    "HasSlopes",
    "RunsAway",
    "Sensitivity",
    "Simulated",
    "Singular",
    "Slopes",
    "sensitivities",
    "simulated",
]
