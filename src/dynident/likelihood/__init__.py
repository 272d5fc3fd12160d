"""Maximum likelihood of eq. (7): a spline trajectory and the parameters, fitted together to positions and torques."""

from dynident.likelihood.fit import Fitted, Settings, maximise
from dynident.likelihood.segment import Segment
from dynident.likelihood.trajectory import Trajectory

__all__ = ["Fitted", "Segment", "Settings", "Trajectory", "maximise"]
