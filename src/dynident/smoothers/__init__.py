"""Smoothers: Log -> Motion. A family of interchangeable parts; ``smoother`` holds their protocol."""

from dynident.smoothers.butterworth import Butterworth, cutoff_complaint
from dynident.smoothers.difference import Difference
from dynident.smoothers.fourier import FourierSeries
from dynident.smoothers.kalman import KalmanSmoother
from dynident.smoothers.outliers import SUBSTITUTE, motion_of, repaired
from dynident.smoothers.overlap import decay, overlap
from dynident.smoothers.savitzky_golay import SavitzkyGolay
from dynident.smoothers.smoother import BY_JOINT, Smoother, as_used, ends_mask, position_noise
from dynident.smoothers.spline import Spline
from dynident.smoothers.time_offset import LONGEST_OFFSET, TimeShifted, unshifted

__all__ = [
    "BY_JOINT",
    "LONGEST_OFFSET",
    "SUBSTITUTE",
    "Butterworth",
    "Difference",
    "FourierSeries",
    "KalmanSmoother",
    "SavitzkyGolay",
    "Smoother",
    "Spline",
    "TimeShifted",
    "as_used",
    "cutoff_complaint",
    "decay",
    "ends_mask",
    "motion_of",
    "overlap",
    "position_noise",
    "repaired",
    "unshifted",
]
