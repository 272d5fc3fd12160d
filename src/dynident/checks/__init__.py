"""Checks before a fit, in two groups: of logs alone, and of models, alone and with their logs.

Of logs (``time``, ``channels``): gaps, jitter, dead channels, wrong units; pure functions of a ``Log``.
Of models (``robot``, ``motion``, ``torque``, ``gravity``): the robot file, excitation and limits, sign and scale of the
torque, the direction of gravity. ``run_checks`` runs all of them, ``with_findings`` beside an identification. An error
would give wrong numbers, a warning should be looked at."""

from dynident.checks.channels import ChannelFacts, channel_facts, check_log, check_log_fully, rest_findings
from dynident.checks.check import CheckResult, run_checks, with_findings
from dynident.checks.motion import Excitation, ExcitedRank
from dynident.checks.robot import RobotJointFacts, check_robot, joint_facts, link_facts
from dynident.checks.stamps import MAX_GAP_STEPS, MINIMUM_SAMPLES, Timing, respace, split_gaps, timing
from dynident.checks.torque import Agreement, loop_findings, relative_gains
