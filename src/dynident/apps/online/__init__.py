"""A robot that is watched while it works: a result followed on a stream of samples."""

from dynident.apps.online.candidates import Candidates, Threshold, threshold
from dynident.apps.online.detector import (
    Alarm,
    Back,
    BadLines,
    BaselineKnown,
    Changed,
    ClockReset,
    Detector,
    Event,
    Fault,
    FaultKind,
    Gap,
    Knowledge,
    NewMotion,
    Passed,
    Phase,
    Resting,
    Resumed,
    Signal,
    Unreadable,
    Unsteady,
)
from dynident.apps.online.fixed_lag import FinalMotion, FixedLag, StreamSmoothing
from dynident.apps.online.recursive import RecursiveLeastSquares
from dynident.apps.online.scores import Gram, Reference, Scorer, Scores, Sums
from dynident.apps.online.sensors import Sensors
from dynident.apps.online.tracker import MotionBlock, Tracker, estimate_smoothing
from dynident.apps.online.watcher import Watcher, WatchSettings

__all__ = [
    "Alarm",
    "Back",
    "BadLines",
    "BaselineKnown",
    "Candidates",
    "Changed",
    "ClockReset",
    "Detector",
    "Event",
    "Fault",
    "FaultKind",
    "FinalMotion",
    "FixedLag",
    "Gap",
    "Gram",
    "Knowledge",
    "MotionBlock",
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
    "StreamSmoothing",
    "Sums",
    "Threshold",
    "Tracker",
    "Unreadable",
    "Unsteady",
    "WatchSettings",
    "Watcher",
    "estimate_smoothing",
    "threshold",
]
