"""A robot with a branch, a prismatic joint, a mimic joint and a locked one, identified from short logs."""

from dataclasses import replace
from functools import cache

import numpy as np

from dynident.estimators import Estimator, LeastSquares
from dynident.identification import Identification, Recipe, SourceFile, identify
from dynident.models import Model, RigidBodies
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline

_LINK = """<link name="{0}"><inertial><origin xyz="{1}"/><mass value="{2}"/>
<inertia ixx="0.02" iyy="0.025" izz="0.015" ixy="0.001" ixz="0" iyz="0"/></inertial>{3}</link>"""
_JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="{4}" rpy="0.1 0.2 0"/>
<axis xyz="{5}"/><limit lower="-2" upper="2" velocity="5" effort="50"/>{6}</joint>"""
_BOX = '<collision><geometry><box size="0.1 0.1 0.3"/></geometry></collision>'
_MESH = '<collision><geometry><mesh filename="missing.stl"/></geometry></collision>'
TREE = "".join(
    (
        f'<robot name="tree"><link name="root">{_BOX}</link>',
        _LINK.format("turret", "0.05 0.02 0.1", 4, _BOX),
        _LINK.format("slide", "0.02 0.1 0", 2, _MESH),
        _LINK.format("&lt;b&gt;hand", "0 0.02 0.1", 0.7, ""),
        _LINK.format("finger", "0.03 0 0.05", 0.3, ""),
        _LINK.format("camera", "0 0 0.05", 0.2, ""),
        _JOINT.format("pan", "revolute", "root", "turret", "0 0 0.2", "0 1 0", ""),
        _JOINT.format("reach", "prismatic", "turret", "slide", "0.2 0 0.3", "0 0 1", ""),
        _JOINT.format("wrist", "revolute", "slide", "&lt;b&gt;hand", "0.1 0 0.3", "0.48 0.6 0.64", ""),
        _JOINT.format("grip", "revolute", "slide", "finger", "0 0.1 0.3", "1 0 0",
                      '<mimic joint="wrist" multiplier="-0.5" offset="0.2"/>'),
        _JOINT.format("look", "revolute", "turret", "camera", "0 0.2 0.3", "0 0 1", ""),
        "</robot>",
    )
)  # fmt: skip


def tree() -> RigidBodies:
    """The bodies of the robot: the camera is held still."""
    return RigidBodies(TREE, ("pan", "reach", "wrist"), {"look": 0.4}, source="tree.urdf")


@cache
def identified(estimator: Estimator | None = None) -> Identification:
    """The robot identified from two logs, the second held out."""
    bodies, t, rng = tree(), np.arange(350) * 0.02, np.random.default_rng(5)
    model = Model((bodies,), name="tree")
    theta = np.array([parameter.value for parameter in model.parameters]) * 1.05
    logs = {}
    for name, phase in (("monday", 0.0), ("tuesday", 1.0)):
        wave = np.outer(t, [1.3, 2.1, 3.2]) * 2.2 + phase
        speed = np.array([1.3, 2.1, 3.2]) * 2.2
        size = np.array([0.8, 0.3, 0.9])
        q, dq, ddq = size * np.sin(wave), size * speed * np.cos(wave), -size * speed**2 * np.sin(wave)
        tau = model.torque(q, dq, ddq, theta=theta) + 0.02 * rng.standard_normal(q.shape)
        q = q + 1e-5 * rng.standard_normal(q.shape)
        logs[name] = Log(t, q, tau, tuple(joint.name for joint in model.joints), name)
    recipe = Recipe(Spline(sigma=1e-5), estimator=estimator or LeastSquares())
    result = identify(model, {"monday": logs["monday"]}, {"tuesday": logs["tuesday"]}, recipe)
    return replace(result, provenance=replace(result.provenance, model=SourceFile("nowhere/tree.urdf", "", TREE)))
