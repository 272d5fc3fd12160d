"""Shapes of a MuJoCo model."""

import numpy as np
import pytest

import dynident as dy
from dynident.models.robot_files import ShapeKind

MODEL = """<mujoco><compiler angle="radian" meshdir="../assets"/>
<default><mesh scale="0.001 0.001 0.001"/><default class="seen"><geom contype="0" conaffinity="0"/></default></default>
<asset><mesh name="shell" file="sub/shell.stl"/><mesh file="bare.obj" scale="1 1 2"/>
<mesh name="moved" file="a.stl" refpos="1 0 0"/></asset>
<worldbody><geom type="plane" size="1 1 1"/><geom type="box" size="1 2 3" pos="0 0 -3"/>
<body pos="0 0 1"><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
<joint name="one" axis="0 0 1" pos="0.1 0 0"/>
<geom fromto="0 0 0 0 0 1" size="0.1" type="capsule"/>
<geom class="seen" type="mesh" mesh="shell" pos="0.5 0 0"/><frame pos="0 2 0"><geom type="mesh" mesh="bare"/></frame>
<geom type="mesh" mesh="moved"/><geom type="ellipsoid" size="1 2 3"/><geom type="hfield" hfield="ground"/>
<body name="tip" pos="0 0 1"><geom size="0.2"/></body>
</body></worldbody></mujoco>"""


def test_shapes_of_bodies_are_in_the_frames_of_the_links() -> None:
    bodies = dy.RigidBodies(MODEL)
    shapes = bodies.shapes
    assert set(shapes) == {"world", "body 1", "tip"}
    assert [x.kind for x in shapes["world"].collision] == [ShapeKind.BOX]
    body = shapes["body 1"]
    assert [x.kind for x in body.collision] == [
        ShapeKind.CAPSULE, ShapeKind.MESH, ShapeKind.MESH, ShapeKind.ELLIPSOID,
    ]  # fmt: skip
    capsule, bare, moved, ellipsoid = body.collision
    assert capsule.size == pytest.approx((0.1, 0.5))
    assert capsule.frame[:3, 3] == pytest.approx([-0.1, 0, 0.5])  # the link's frame is at the joint
    assert np.abs(capsule.frame[:3, 2]) == pytest.approx([0, 0, 1])
    assert (bare.file, bare.size) == ("../assets/bare.obj", (1, 1, 2))
    assert bare.frame[:3, 3] == pytest.approx([-0.1, 2, 0])
    assert moved.file == ""
    assert ellipsoid.size == (1, 2, 3)
    (shell,) = body.visual
    assert (shell.file, shell.size) == ("../assets/sub/shell.stl", (0.001, 0.001, 0.001))
    assert shell.frame[:3, 3] == pytest.approx([0.4, 0, 0])


def test_paths_are_stripped_where_the_compiler_says_so() -> None:
    shapes = dy.RigidBodies(MODEL.replace("<compiler", '<compiler strippath="true"')).shapes
    assert shapes["body 1"].visual[0].file == "../assets/shell.stl"
