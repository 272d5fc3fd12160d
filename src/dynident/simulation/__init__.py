"""Recordings simulated with a model: controllers, the steps, and their exact derivatives."""

from dynident.simulation.controllers import PD, PID, CascadePD, Function, HasTimes
from dynident.simulation.differenced import Differenced
from dynident.simulation.failure import Broken, Failure, RunsAway, Singular
from dynident.simulation.run import Simulated, simulated
from dynident.simulation.sensitivity import Sensitivity, sensitivities
from dynident.simulation.slopes import HasSlopes, Seen, Slopes
from dynident.simulation.ticks import Ticks, longest, ticks

__all__ = [
    "PD",
    "PID",
    "Broken",
    "CascadePD",
    "Differenced",
    "Failure",
    "Function",
    "HasSlopes",
    "HasTimes",
    "RunsAway",
    "Seen",
    "Sensitivity",
    "Simulated",
    "Singular",
    "Slopes",
    "Ticks",
    "longest",
    "sensitivities",
    "simulated",
    "ticks",
]
