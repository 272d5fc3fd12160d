"""Shapes of a URDF."""

import pytest

import dynident as dy
from dynident.models.robot_files import ShapeKind
from dynident.runtime import ModelError
from tests.robots import joint, link, urdf


def shapes(inside):
    part = link("arm", 1.0).replace("</link>", f"{inside}</link>")
    return dy.RigidBodies(urdf(link("base"), part, joint("one", "revolute", "base", "arm"))).shapes["arm"]


def collision(shape, origin=""):
    return f"<collision>{origin}<geometry>{shape}</geometry></collision>"


@pytest.mark.parametrize(
    ("shape", "kind", "size"),
    [
        ('<box size="1 2 3"/>', ShapeKind.BOX, (0.5, 1.0, 1.5)),
        ('<sphere radius="2"/>', ShapeKind.SPHERE, (2.0,)),
        ('<cylinder radius="2" length="3"/>', ShapeKind.CYLINDER, (2.0, 1.5)),
        ('<capsule radius="2" length="3"/>', ShapeKind.CAPSULE, (2.0, 1.5)),
        ('<mesh filename="a.stl"/>', ShapeKind.MESH, (1.0, 1.0, 1.0)),
        ('<mesh filename="a.stl" scale="1 2 -1"/>', ShapeKind.MESH, (1.0, 2.0, -1.0)),
    ],
)
def test_each_shape_has_its_size(shape, kind, size) -> None:
    (result,) = shapes(collision(shape)).collision
    assert (result.kind, result.size) == (kind, size)
    assert result.file == ("a.stl" if kind is ShapeKind.MESH else "")


def test_what_is_seen_and_what_collides_are_kept_apart() -> None:
    result = shapes(
        collision('<sphere radius="1"/>') * 2 + collision('<box size="1 1 1"/>').replace("collision", "visual")
    )
    assert [x.kind for x in result.collision] == [ShapeKind.SPHERE] * 2
    assert [x.kind for x in result.visual] == [ShapeKind.BOX]


@pytest.mark.parametrize(
    ("shape", "what"),
    [
        ('<sphere radius="0"/>', r"<collision> of link 'arm': a sphere of the size \(0.0,\); give lengths above zero"),
        ('<box size="1 2"/>', "size = '1 2', expected 3 numbers"),
        ("<cylinder radius='1'/>", "length = ''"),
    ],
)
def test_a_wrong_size_is_refused_when_shapes_are_asked_for(shape, what) -> None:
    with pytest.raises(ModelError, match=what):
        shapes(collision(shape))


def test_unknown_shapes_are_left_out() -> None:
    assert shapes(collision('<polyline height="1"/>') + "<collision/>").collision == ()
