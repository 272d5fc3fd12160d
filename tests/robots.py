"""Robot files for tests: a writer of URDF texts, and one small arm in both formats."""

import numpy as np


def words(values):
    return " ".join(repr(float(x)) for x in values)


def link(name, mass=None, centre=(0, 0, 0), turn=(0, 0, 0), tensor=None):
    """A <link>; ``tensor`` (3, 3) is about the centre of mass, in a frame turned by roll, pitch, yaw."""
    if mass is None:
        return f'<link name="{name}"/>'
    J = np.diag([0.1, 0.1, 0.1]) * mass if tensor is None else np.asarray(tensor)
    entries = {"ixx": J[0, 0], "ixy": J[0, 1], "ixz": J[0, 2], "iyy": J[1, 1], "iyz": J[1, 2], "izz": J[2, 2]}
    inertia = " ".join(f'{key}="{float(value)!r}"' for key, value in entries.items())
    return (
        f'<link name="{name}"><inertial><origin xyz="{words(centre)}" rpy="{words(turn)}"/>'
        f'<mass value="{float(mass)!r}"/><inertia {inertia}/></inertial></link>'
    )


def joint(name, kind, parent, child, xyz=(0, 0, 0), rpy=(0, 0, 0), axis=(0, 0, 1), inside=""):
    if kind in ("revolute", "prismatic") and "<limit" not in inside:
        inside += '<limit effort="10" velocity="2" lower="-1" upper="1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{words(xyz)}" rpy="{words(rpy)}"/><axis xyz="{words(axis)}"/>{inside}</joint>'
    )


def urdf(*parts):
    return f'<?xml version="1.0"?>\n<robot name="test">{"".join(parts)}</robot>'


def three_joints(*, base_axis=(0, 0, 1), fore_centre=(0.1, 0.01, 0), wrist="revolute"):
    """An arm that turns about z or ``base_axis``, about y, and about or along x."""
    return urdf(
        link("base"),
        link("shoulder", 3.0, (0.1, 0.02, 0.05)),
        link("upper", 2.0, (0.15, 0.0, 0.02)),
        link("fore", 1.0, fore_centre),
        joint("j1", "revolute", "base", "shoulder", axis=base_axis),
        joint("j2", "revolute", "shoulder", "upper", xyz=(0.2, 0, 0.3), axis=(0, 1, 0)),
        joint("j3", wrist, "upper", "fore", xyz=(0.4, 0, 0), axis=(1, 0, 0)),
    )


UPPER = np.array([[0.03, 0.002, 0.001], [0.002, 0.025, -0.003], [0.001, -0.003, 0.02]])
TURN = (0.3, -0.4, 0.5)
AXIS = np.array([0.0, 0.6, 0.8])
ARM = urdf(
    link("base", 4.0),
    link("upper", 2.0, (0.1, -0.05, 0.2), TURN, UPPER),
    link("slide", 1.0, (0.0, 0.02, 0.1), tensor=np.diag([0.01, 0.012, 0.008])),
    link("tool", 0.5, (0.0, 0.0, 0.05), tensor=np.diag([0.002, 0.002, 0.001])),
    link("wrist", 0.7, (0.02, 0.0, 0.03), tensor=np.diag([0.003, 0.004, 0.002])),
    joint("shoulder", "revolute", "base", "upper", (0.0, 0.1, 0.3), (0.1, 0.2, 0.3), AXIS),
    joint("rail", "prismatic", "upper", "slide", (0.2, 0.0, 0.1), (0.0, 0.5, 0.0), (1.0, 0.0, 0.0)),
    joint("flange", "fixed", "slide", "tool", (0.0, 0.1, 0.0), (0.4, 0.0, 0.0)),
    joint("twist", "continuous", "slide", "wrist", (0.0, 0.0, 0.2), (0.0, 0.0, 0.7), (0.0, 1.0, 0.0)),
)
"""Revolute, prismatic and continuous, with a turned inertia and a tool that is fixed."""

ARM_MJCF = """<mujoco model="test"><compiler angle="radian" eulerseq="XYZ"/>
<default><joint damping="0.4"/><default class="thin"><joint armature="0.01" damping="0.1"/></default></default>
<asset><mesh name="shell" file="missing.stl"/></asset>
<worldbody><geom type="plane" size="1 1 1"/>
<body name="base"><inertial mass="4" pos="0 0 0" diaginertia="0.4 0.4 0.4"/>
<body name="upper" pos="0 0.1 0.3" euler="0.1 0.2 0.3"><geom type="mesh" mesh="shell"/>
<inertial mass="2" pos="0.1 -0.05 0.2"
fullinertia="0.025370055342652652 0.028070781531189696 0.021559163126157604
 0.0014174657172840099 0.004657401264586104 0.0021439228345019193"/>
<joint name="shoulder" axis="0 0.6 0.8" range="-1 1" actuatorfrcrange="-10 10" frictionloss="0.2"/>
<body name="slide" pos="0.2 0 0.1" axisangle="0 2 0 0.5" childclass="thin">
<inertial mass="1" pos="0 0.02 0.1" diaginertia="0.01 0.012 0.008"/>
<joint name="rail" type="slide" axis="1 0 0" range="-1 1"/>
<body name="tool" pos="0 0.1 0" quat="0.9800665778412416 0.19866933079506122 0 0">
<inertial mass="0.5" pos="0 0 0.05" diaginertia="0.002 0.002 0.001"/></body>
<body name="wrist" pos="0 0 0.2" xyaxes="0.7648421872844885 0.644217687237691 0 -1 1 0">
<inertial mass="0.7" pos="0.02 0 0.03" diaginertia="0.003 0.004 0.002"/>
<joint name="twist" axis="0 1 0" class="main"/></body>
</body></body></body></worldbody></mujoco>"""
"""The same arm for MuJoCo, with orientations in five notations and a mesh that does not exist."""
GRIPPER = urdf(
    link("base"),
    link("arm", 2.0, (0, 0, 0.1)),
    link("left", 0.1),
    link("right", 0.1),
    joint("elbow", "revolute", "base", "arm", axis=(0, 1, 0)),
    joint("finger", "prismatic", "arm", "left", axis=(0, 1, 0)),
    joint(
        "follower", "prismatic", "arm", "right", axis=(0, -1, 0),
        inside='<mimic joint="finger" multiplier="2" offset="0.01"/>',
    ),
)  # fmt: skip
