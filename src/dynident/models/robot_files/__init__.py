"""The content of robot files (URDF, MJCF): bodies, joints, limits and shapes."""

from dynident.models.robot_files.arm import Arm, ArmBody, assemble, displace_joints
from dynident.models.robot_files.mjcf import mjcf_shapes, read_mjcf
from dynident.models.robot_files.mjcf_compile import UNNAMED, compile_mjcf
from dynident.models.robot_files.urdf import read_urdf, urdf_shapes
from dynident.models.robot_files.xml import (
    MAX_NUMBER,
    JointCoupling,
    LinkShapes,
    LinkTie,
    RobotFile,
    RobotJoint,
    RobotJointLimits,
    Shape,
    ShapeKind,
    angles,
    check_known,
    check_unique,
    exact_angle,
    motion_matrix,
    note_exact_angles,
    numbers,
    parse,
    placement,
    rotation,
    unit_vector,
)
