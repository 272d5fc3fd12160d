"""Maximum likelihood of eq. (7): a spline trajectory and the parameters, fitted together to positions and torques."""

from dynident.estimators.maximum_likelihood.equations import Equations, equations, leverage, scores
from dynident.estimators.maximum_likelihood.fit import MaximumLikelihood
from dynident.estimators.maximum_likelihood.friction import has_sign, with_smooth_signs
from dynident.estimators.maximum_likelihood.likelihood import Likelihood
from dynident.estimators.maximum_likelihood.newton import LikelihoodFit, NewtonSettings, maximise
from dynident.estimators.maximum_likelihood.physics import psd_constraints
from dynident.estimators.maximum_likelihood.plan import plan, steps_of, whiteness
from dynident.estimators.maximum_likelihood.search import Recordings, Search
from dynident.estimators.maximum_likelihood.segment import Segment, Sigma, State
from dynident.estimators.maximum_likelihood.trajectory import Trajectory

__all__ = [
    "Equations",
    "Likelihood",
    "LikelihoodFit",
    "MaximumLikelihood",
    "NewtonSettings",
    "Recordings",
    "Search",
    "Segment",
    "Sigma",
    "State",
    "Trajectory",
    "equations",
    "has_sign",
    "leverage",
    "maximise",
    "plan",
    "psd_constraints",
    "scores",
    "steps_of",
    "whiteness",
    "with_smooth_signs",
]
