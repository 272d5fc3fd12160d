"""What a log says of itself, before any model: gaps, jitter, dead or saturated channels, wrong units.

Pure functions of a ``Log``. An error is a log that would give wrong numbers, a warning one to look at.
"""

from dynident.diagnostics.channels import Channel, channels, check, inspect, moving, rest
from dynident.diagnostics.finding import Finding, Topic, require
from dynident.diagnostics.note import Note, Remark, Severity
from dynident.diagnostics.time import MINIMUM_SAMPLES, Timing, split_gaps, timing

__all__ = [
    "MINIMUM_SAMPLES",
    "Channel",
    "Finding",
    "Note",
    "Remark",
    "Severity",
    "Timing",
    "Topic",
    "channels",
    "check",
    "inspect",
    "moving",
    "require",
    "rest",
    "split_gaps",
    "timing",
]
