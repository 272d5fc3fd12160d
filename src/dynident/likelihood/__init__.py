"""Maximum likelihood of eq. (7): a spline trajectory and the parameters, fitted together to positions and torques."""

from dynident.likelihood.barrier import Barrier, Demand, demands
from dynident.likelihood.fit import Fitted, Settings, maximise
from dynident.likelihood.plan import noise, plan, steps_of, whiteness
from dynident.likelihood.segment import Segment, State
from dynident.likelihood.trajectory import Trajectory

__all__ = [
    "Barrier", "Demand", "Fitted", "Segment", "Settings", "State", "Trajectory", "demands", "maximise", "noise", "plan",
    "steps_of", "whiteness",
]  # fmt: skip
