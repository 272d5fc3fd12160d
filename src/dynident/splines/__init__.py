"""Smoothing splines after Reinsch (1967), as such and as integrated Wiener processes: pure numerics, usable alone."""

from dynident.splines.noise import NORMAL_95, coloured_noise, median_sigma, noise_sigma, steady_noise
from dynident.splines.rules import GCV, REML, Constraint, Fixed, Interpolation, Rule, rule_named
from dynident.splines.spikes import LONGEST_SPIKE, bridged, frozen, largest_up_to, spikes, torn_ends
from dynident.splines.spline import SmoothingSpline, smooth
from dynident.splines.stretches import stretches
from dynident.splines.wiener import Order, WienerFit, posterior_errors, wiener

__all__ = [
    "GCV",
    "LONGEST_SPIKE",
    "NORMAL_95",
    "REML",
    "Constraint",
    "Fixed",
    "Interpolation",
    "Order",
    "Rule",
    "SmoothingSpline",
    "WienerFit",
    "bridged",
    "coloured_noise",
    "frozen",
    "largest_up_to",
    "median_sigma",
    "noise_sigma",
    "posterior_errors",
    "rule_named",
    "smooth",
    "spikes",
    "steady_noise",
    "stretches",
    "torn_ends",
    "wiener",
]
