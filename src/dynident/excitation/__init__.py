"""Motions that show the parameters of a robot: trajectories within its limits, and what they will tell."""

from dynident.excitation.capsules import Capsule, Made
from dynident.excitation.clearance import CapsuleSpace
from dynident.excitation.design import Design, design
from dynident.excitation.expected import Expected, expected
from dynident.excitation.limits import JointLimits, MotionLimits, limits_of
from dynident.excitation.request import Criterion, Programme, Request
from dynident.excitation.space import Box, Cylinder, Floor, Obstacle, Space
from dynident.excitation.trajectory import Course, Piece, Purpose, Trajectory

__all__ = [
    "Box",
    "Capsule",
    "CapsuleSpace",
    "Course",
    "Criterion",
    "Cylinder",
    "Design",
    "Expected",
    "Floor",
    "JointLimits",
    "Made",
    "MotionLimits",
    "Obstacle",
    "Piece",
    "Programme",
    "Purpose",
    "Request",
    "Space",
    "Trajectory",
    "design",
    "expected",
    "limits_of",
]
