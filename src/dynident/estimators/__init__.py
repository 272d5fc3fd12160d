"""Estimators: Problem -> Estimate. A family of interchangeable parts; ``estimator`` holds their protocol."""

from dynident.estimators.augmented_kalman.fit import AugmentedKalman
from dynident.estimators.estimator import (
    Consistency,
    Determined,
    Estimate,
    Estimator,
    NamesParameters,
    NeedsSamples,
    Pieces,
    Problem,
    Provenance,
    Residual,
    among,
    needs_samples,
    quick,
)
from dynident.estimators.generalised_least_squares import GeneralisedLeastSquares
from dynident.estimators.instrumental_variables import InstrumentalVariables
from dynident.estimators.least_squares import LeastSquares
from dynident.estimators.linear import IsLinear, LinearFit, estimate_of, of_information
from dynident.estimators.maximum_likelihood.fit import MaximumLikelihood
from dynident.estimators.output_error import Didim, OutputError
from dynident.estimators.physically_consistent.fit import PhysicallyConsistent
from dynident.estimators.ridge import Ridge
from dynident.estimators.robust import RobustLeastSquares
from dynident.estimators.total_least_squares import TotalLeastSquares
from dynident.estimators.weighted_least_squares import WeightedLeastSquares

__all__ = [
    "AugmentedKalman",
    "Consistency",
    "Determined",
    "Didim",
    "Estimate",
    "Estimator",
    "GeneralisedLeastSquares",
    "InstrumentalVariables",
    "IsLinear",
    "LeastSquares",
    "LinearFit",
    "MaximumLikelihood",
    "NamesParameters",
    "NeedsSamples",
    "OutputError",
    "PhysicallyConsistent",
    "Pieces",
    "Problem",
    "Provenance",
    "Residual",
    "Ridge",
    "RobustLeastSquares",
    "TotalLeastSquares",
    "WeightedLeastSquares",
    "among",
    "estimate_of",
    "needs_samples",
    "of_information",
    "quick",
]
