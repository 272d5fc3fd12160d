"""Accuracy bounds: the Cramer-Rao bound for a simulated motion, and for a recording with its sensors."""

from dynident.bounds.accuracy import (
    CHANGES,
    AccuracyBound,
    Measure,
    Noise,
    Origin,
    TorqueNoise,
    accuracy_bound,
    noise_of,
)
from dynident.bounds.cramer_rao import cramer_rao_bound, information, variance
from dynident.bounds.normal_matrix import NormalMatrix, normal_matrices

__all__ = [
    "CHANGES",
    "AccuracyBound",
    "Measure",
    "Noise",
    "NormalMatrix",
    "Origin",
    "TorqueNoise",
    "accuracy_bound",
    "cramer_rao_bound",
    "information",
    "noise_of",
    "normal_matrices",
    "variance",
]
