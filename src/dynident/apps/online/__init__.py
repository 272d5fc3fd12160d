"""A robot that is watched while it works: a result followed on a stream of samples."""

from dynident.apps.online.events import (
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
from dynident.apps.online.fixed_lag import FinalMotion, FixedLag, StreamSmoothing
from dynident.apps.online.recursive import RecursiveLeastSquares
from dynident.apps.online.tracker import MotionBlock, Tracker, estimate_smoothing
from dynident.apps.online.watcher import Watcher, WatchSettings
