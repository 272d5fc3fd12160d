"""Maximum likelihood of eq. (7): a spline trajectory and the parameters, fitted together to positions and torques."""

from dynident.likelihood.equations import Equations, equations, leverage, scores
from dynident.likelihood.fit import Fitted, Likelihood, Settings, maximise
from dynident.likelihood.friction import has_sign, softened
from dynident.likelihood.physics import demands
from dynident.likelihood.plan import plan, steps_of, whiteness
from dynident.likelihood.search import Recordings, Search
from dynident.likelihood.segment import Segment, Sigma, State
from dynident.likelihood.trajectory import Trajectory

__all__ = [
    "Equations", "Fitted", "Likelihood", "Recordings", "Search", "Segment", "Settings", "Sigma", "State", "Trajectory",
    "demands", "equations", "has_sign", "leverage", "maximise", "plan", "scores", "softened", "steps_of", "whiteness",
]  # fmt: skip
