"""Estimators: Problem -> Estimate. A family of interchangeable parts; ``estimator`` holds their base class."""

from dynident.estimators.augmented_kalman import AugmentedKalman
from dynident.estimators.barrier import Barrier, PenalisedQuadratic
from dynident.estimators.estimator import (
    Consistency,
    DataRank,
    Estimate,
    Estimator,
    Pieces,
    Problem,
    Provenance,
    Residual,
)
from dynident.estimators.generalised_least_squares import GeneralisedLeastSquares, WeightedLeastSquares
from dynident.estimators.instrumental_variables import InstrumentalVariables
from dynident.estimators.least_squares import LeastSquares, LinearEstimator, LinearFit
from dynident.estimators.output_error import Didim, OutputError
from dynident.estimators.physical_constraints import (
    BodyConstraint,
    Constraints,
    Limit,
    PsdConstraint,
    bodies_of,
    centre_of_mass_limit,
    estimate_sizes,
    interval_limit,
    parameter_scales,
    sign_limits,
)
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.estimators.ridge import Ridge
from dynident.estimators.robust_least_squares import RobustLeastSquares
from dynident.estimators.total_least_squares import TotalLeastSquares
