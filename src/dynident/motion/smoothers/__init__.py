"""Smoothers: from measured positions to positions, velocities and accelerations."""

from dynident.motion.smoothers.difference import Butterworth, Difference, cutoff_complaint
from dynident.motion.smoothers.fourier import FourierSeries
from dynident.motion.smoothers.kalman import KalmanSmoother, Order, WienerFit, posterior_errors, wiener
from dynident.motion.smoothers.savitzky_golay import SavitzkyGolay
from dynident.motion.smoothers.smoother import (
    BY_JOINT,
    MAX_TIME_OFFSET,
    SUBSTITUTE,
    Smoother,
    TimeShifted,
    decay,
    ends_mask,
    overlap,
    position_noise,
    repair_log,
    smooth_log,
    strip_time_offset,
)
from dynident.motion.smoothers.spline import Spline
