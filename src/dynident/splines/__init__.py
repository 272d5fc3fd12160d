"""Natural cubic smoothing splines after Reinsch (1967): pure numerics, usable alone."""

from dynident.splines.noise import noise_sigma
from dynident.splines.rules import GCV, REML, Constraint, Fixed, Interpolation, Rule, rule_named
from dynident.splines.spline import SmoothingSpline, smooth

__all__ = [
    "GCV",
    "REML",
    "Constraint",
    "Fixed",
    "Interpolation",
    "Rule",
    "SmoothingSpline",
    "noise_sigma",
    "rule_named",
    "smooth",
]
