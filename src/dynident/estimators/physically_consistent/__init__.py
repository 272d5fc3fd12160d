"""Least squares with physical constraints, and a prior for what the data do not determine."""

from dynident.estimators.physically_consistent.fit import PhysicallyConsistent

__all__ = ["PhysicallyConsistent"]
