"""Motions that show the parameters of a robot: trajectories within its limits, and what they will tell."""

from dynident.excitation.design import Design, Interrupted, design
from dynident.excitation.expected import Expected, expected
from dynident.excitation.request import Criterion, Program, Request
from dynident.excitation.request_checks import LeftOut
from dynident.excitation.spaces.capsules import Capsule
from dynident.excitation.spaces.clearance import CapsuleSpace
from dynident.excitation.spaces.exact_space import exact_space
from dynident.excitation.spaces.geometry import Geometry, Made, Mesh, rods_of
from dynident.excitation.spaces.outlines import Outline, outlines
from dynident.excitation.spaces.pairing import space_of
from dynident.excitation.spaces.space import Box, Cylinder, Distances, Floor, Nothing, Obstacle, Space
from dynident.excitation.trajectories.dry_friction import slowest
from dynident.excitation.trajectories.limits import JointLimits, MotionLimits, limits_of
from dynident.excitation.trajectories.nearest import Nearest
from dynident.excitation.trajectories.slowed import slowed
from dynident.excitation.trajectories.trajectory import Course, Piece, Purpose, Trajectory
from dynident.excitation.verify import LimitError, Verified, verify

__all__ = [
    "Box",
    "Capsule",
    "CapsuleSpace",
    "Course",
    "Criterion",
    "Cylinder",
    "Design",
    "Distances",
    "Expected",
    "Floor",
    "Geometry",
    "Interrupted",
    "JointLimits",
    "LeftOut",
    "LimitError",
    "Made",
    "Mesh",
    "MotionLimits",
    "Nearest",
    "Nothing",
    "Obstacle",
    "Outline",
    "Piece",
    "Program",
    "Purpose",
    "Request",
    "Space",
    "Trajectory",
    "Verified",
    "design",
    "exact_space",
    "expected",
    "limits_of",
    "outlines",
    "rods_of",
    "slowed",
    "slowest",
    "space_of",
    "verify",
]
