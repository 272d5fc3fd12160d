"""Least squares under physics: positive masses and inertias, signs of friction, and a prior where data say nothing."""

from dynident.estimators.physically_consistent.fit import PhysicallyConsistent

__all__ = ["PhysicallyConsistent"]
