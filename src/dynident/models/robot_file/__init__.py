"""Robot files: from the text of a URDF or MJCF to links and joints, and from these to moving bodies."""

from dynident.models.robot_file.arm import Arm, ArmBody, assemble, displaced
from dynident.models.robot_file.mjcf import UNNAMED, read_mjcf
from dynident.models.robot_file.mjcf_shapes import mjcf_shapes
from dynident.models.robot_file.shapes import LinkShapes, Shape, ShapeKind
from dynident.models.robot_file.urdf import read_urdf
from dynident.models.robot_file.urdf_shapes import urdf_shapes
from dynident.models.robot_file.xml import (
    HUGE,
    Coupled,
    Limits,
    RobotFile,
    RobotJoint,
    Tied,
    angles,
    corrected,
    exact,
    known,
    motion,
    numbers,
    parse,
    placement,
    rotation,
    unique,
    unit,
)

__all__ = [
    "HUGE",
    "UNNAMED",
    "Arm",
    "ArmBody",
    "Coupled",
    "Limits",
    "LinkShapes",
    "RobotFile",
    "RobotJoint",
    "Shape",
    "ShapeKind",
    "Tied",
    "angles",
    "assemble",
    "corrected",
    "displaced",
    "exact",
    "known",
    "mjcf_shapes",
    "motion",
    "numbers",
    "parse",
    "placement",
    "read_mjcf",
    "read_urdf",
    "rotation",
    "unique",
    "unit",
    "urdf_shapes",
]
