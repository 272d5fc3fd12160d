"""Estimators: Problem -> Estimate. A family of interchangeable parts; ``estimator`` holds their protocol."""

from dynident.estimators.consistent import Consistent
from dynident.estimators.estimator import Estimate, Estimator, Problem, Provenance, quick
from dynident.estimators.least_squares import LeastSquares
from dynident.estimators.maximum_likelihood import MaximumLikelihood

__all__ = [
    "Consistent",
    "Estimate",
    "Estimator",
    "LeastSquares",
    "MaximumLikelihood",
    "Problem",
    "Provenance",
    "quick",
]
