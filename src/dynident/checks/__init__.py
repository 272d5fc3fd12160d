"""Checks before a fit, in two groups: of logs alone, and of models, alone and with their logs.

Of logs (``time``, ``channels``): gaps, jitter, dead channels, wrong units; pure functions of a ``Log``.
Of models (``robot``, ``motion``, ``torque``, ``gravity``): the robot file, excitation and limits, sign and scale of the
torque, the direction of gravity. ``run_checks`` runs all of them, ``with_findings`` beside an identification. An error
would give wrong numbers, a warning should be looked at."""

from dynident.checks import notes
from dynident.checks.beside import with_findings
from dynident.checks.channels import ChannelFacts, channels, check_log, check_log_fully, rest
from dynident.checks.check import CheckResult, run_checks
from dynident.checks.finding import Finding, Topic, reading_line, require
from dynident.checks.loop import loop_findings
from dynident.checks.motion import Excitation, ExcitedRank
from dynident.checks.reading import reading_words
from dynident.checks.relative_gains import relative_gains
from dynident.checks.robot import JointFacts, LinkFacts, check_robot, joint_facts, link_facts
from dynident.checks.time import GAP, MINIMUM_SAMPLES, Timing, respaced, split_gaps, timing
from dynident.checks.torque import Agreement

__all__ = [
    "GAP",
    "MINIMUM_SAMPLES",
    "Agreement",
    "ChannelFacts",
    "CheckResult",
    "Excitation",
    "ExcitedRank",
    "Finding",
    "JointFacts",
    "LinkFacts",
    "Timing",
    "Topic",
    "channels",
    "check_log",
    "check_log_fully",
    "check_robot",
    "joint_facts",
    "link_facts",
    "loop_findings",
    "notes",
    "reading_line",
    "reading_words",
    "relative_gains",
    "require",
    "respaced",
    "rest",
    "run_checks",
    "split_gaps",
    "timing",
    "with_findings",
]
