"""A robot that is watched: recursive least squares, derivatives with a fixed lag, detection of changes."""

from dynident.online.candidates import Candidates
from dynident.online.detector import Detector, Knowledge, Phase
from dynident.online.events import (
    Alarm,
    Back,
    BadLines,
    BaselineKnown,
    Changed,
    ClockReset,
    Event,
    Fault,
    FaultKind,
    Gap,
    NewMotion,
    Passed,
    Resting,
    Resumed,
    Signal,
    Unreadable,
    Unsteady,
)
from dynident.online.evidence import Threshold, threshold
from dynident.online.fixed_lag import FixedLag, Smoothed
from dynident.online.recursive import RecursiveLeastSquares
from dynident.online.reference import Reference
from dynident.online.scores import Gram, Scorer, Scores
from dynident.online.sensors import Sensors
from dynident.online.tracker import Block, Tracker, smoothing_of
from dynident.online.watcher import Watcher, WatchSettings
from dynident.online.windows import Sums

__all__ = [
    "Alarm",
    "Back",
    "BadLines",
    "BaselineKnown",
    "Block",
    "Candidates",
    "Changed",
    "ClockReset",
    "Detector",
    "Event",
    "Fault",
    "FaultKind",
    "FixedLag",
    "Gap",
    "Gram",
    "Knowledge",
    "NewMotion",
    "Passed",
    "Phase",
    "RecursiveLeastSquares",
    "Reference",
    "Resting",
    "Resumed",
    "Scorer",
    "Scores",
    "Sensors",
    "Signal",
    "Smoothed",
    "Sums",
    "Threshold",
    "Tracker",
    "Unreadable",
    "Unsteady",
    "WatchSettings",
    "Watcher",
    "smoothing_of",
    "threshold",
]
