"""The content of robot files (URDF, MJCF): bodies, joints, limits and shapes."""

from dynident.models.robot_files.arm import Arm, ArmBody, assemble, displace_joints
from dynident.models.robot_files.mjcf import mjcf_shapes, read_mjcf
from dynident.models.robot_files.mjcf_compile import UNNAMED, compile_mjcf
from dynident.models.robot_files.urdf import read_urdf, urdf_shapes
from dynident.models.robot_files.xml import (
    JointCoupling,
    LinkShapes,
    RobotFile,
    RobotJoint,
    RobotJointLimits,
    Shape,
    ShapeKind,
    exact_angle,
    motion_matrix,
    parse,
    placement,
    rotation,
)
