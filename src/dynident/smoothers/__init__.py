"""Smoothers: Log -> Motion. A family of interchangeable parts; ``smoother`` holds their protocol."""

from dynident.smoothers.butterworth import Butterworth
from dynident.smoothers.delayed import Delayed, undelayed
from dynident.smoothers.difference import Difference
from dynident.smoothers.smoother import Smoother, ends_mask
from dynident.smoothers.spline import Spline

__all__ = ["Butterworth", "Delayed", "Difference", "Smoother", "Spline", "ends_mask", "undelayed"]
