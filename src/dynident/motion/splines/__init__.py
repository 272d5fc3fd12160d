"""Natural cubic smoothing splines after Reinsch (1967), and what is built on them."""

from dynident.motion.splines.rules import GCV, REML, RULES, Constraint, Fixed, Interpolation, Rule, rule_by_name
from dynident.motion.splines.series import (
    NORMAL_95,
    coloured_noise,
    grid_step,
    least_noise,
    median_sigma,
    noise_sigma,
    steady_noise,
)
from dynident.motion.splines.spikes import (
    LONGEST_SPIKE,
    bridge_gaps,
    frozen_samples,
    spikes,
    stretches,
    torn_ends,
    trailing_maximum,
)
from dynident.motion.splines.spline import SmoothingSpline, smooth
