"""Motions that show the parameters of a robot: trajectories within its limits, and what they will tell."""

from dynident.excitation.capsules import Capsule
from dynident.excitation.clearance import CapsuleSpace
from dynident.excitation.design import Design, Interrupted, design
from dynident.excitation.exact_space import exact_space
from dynident.excitation.expected import Expected, expected, slowest
from dynident.excitation.geometry import Geometry, Made, Mesh
from dynident.excitation.limits import JointLimits, MotionLimits, limits_of
from dynident.excitation.nearest import Nearest
from dynident.excitation.outlines import Outline, outlines
from dynident.excitation.pairing import space_of
from dynident.excitation.request import Criterion, Programme, Request
from dynident.excitation.request_checks import LeftOut
from dynident.excitation.slowed import slowed
from dynident.excitation.space import Box, Cylinder, Distances, Floor, Nothing, Obstacle, Space
from dynident.excitation.trajectory import Course, Piece, Purpose, Trajectory
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
    "Programme",
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
    "slowed",
    "slowest",
    "space_of",
    "verify",
]
