"""Maximum likelihood of eq. (7): a spline trajectory and the parameters, fitted together to positions and torques."""

from dynident.estimators.maximum_likelihood.equations import Hypothesis, Likelihood, equations, leverage
from dynident.estimators.maximum_likelihood.estimator import MaximumLikelihood
from dynident.estimators.maximum_likelihood.newton import NewtonSettings
from dynident.estimators.maximum_likelihood.plan import (
    Recordings,
    has_sign,
    plan_segment,
    torque_steps,
    with_smooth_signs,
)
from dynident.estimators.maximum_likelihood.search import LikelihoodSearch
from dynident.estimators.maximum_likelihood.segment import Sigma
