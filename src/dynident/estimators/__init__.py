"""Estimators: Problem -> Estimate. A family of interchangeable parts; ``estimator`` holds their protocol."""

from dynident.estimators.estimator import Estimate, Estimator, Problem
from dynident.estimators.least_squares import LeastSquares

__all__ = ["Estimate", "Estimator", "LeastSquares", "Problem"]
