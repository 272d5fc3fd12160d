"""A robot that is watched: recursive least squares, derivatives with a fixed lag, detection of changes."""

from dynident.online.fixed_lag import FixedLag, Smoothed
from dynident.online.recursive import RecursiveLeastSquares
from dynident.online.tracker import Block, Tracker, smoothing_of

__all__ = ["Block", "FixedLag", "RecursiveLeastSquares", "Smoothed", "Tracker", "smoothing_of"]
