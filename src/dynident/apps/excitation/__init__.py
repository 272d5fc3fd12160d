"""The design of motions that show the parameters, within all limits of an arm."""

from dynident.apps.excitation.chirp import DEFAULT_RATE, DEFAULT_SPEED, command_csv, design_chirps
from dynident.apps.excitation.clearance import CapsuleSpace
from dynident.apps.excitation.criterion import Criterion
from dynident.apps.excitation.design import Design, ExpectedAccuracy, Interrupted, design, expected_accuracy
from dynident.apps.excitation.exact_space import build_space, exact_space
from dynident.apps.excitation.limits import JointLimits, MotionLimits, min_fit_speeds, motion_limits
from dynident.apps.excitation.motion import LeftOut, MotionRequest, Program
from dynident.apps.excitation.trajectory import ClosestApproach, Course, Piece, Purpose, Trajectory, slow_down
from dynident.apps.excitation.verify import LimitError, TrajectoryCheck, verify
