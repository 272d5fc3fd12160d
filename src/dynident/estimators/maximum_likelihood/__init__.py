"""Maximum likelihood of eq. (7): a spline trajectory and the parameters, fitted together to positions and torques."""

from dynident.estimators.maximum_likelihood.equations import (
    Equations,
    Hypothesis,
    Likelihood,
    equations,
    leverage,
    scores,
)
from dynident.estimators.maximum_likelihood.estimator import MaximumLikelihood, psd_constraints
from dynident.estimators.maximum_likelihood.newton import LikelihoodFit, NewtonSettings, maximise
from dynident.estimators.maximum_likelihood.plan import (
    Recordings,
    has_sign,
    plan_segment,
    torque_steps,
    whiteness_probability,
    with_smooth_signs,
)
from dynident.estimators.maximum_likelihood.search import LikelihoodSearch
from dynident.estimators.maximum_likelihood.segment import Segment, Sigma, State
from dynident.estimators.maximum_likelihood.trajectory import SplineTrajectory
