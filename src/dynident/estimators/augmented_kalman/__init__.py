"""Kalman filtering with the parameters as states."""

from dynident.estimators.augmented_kalman.fit import AugmentedKalman

__all__ = ["AugmentedKalman"]
