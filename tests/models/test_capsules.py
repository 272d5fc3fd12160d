"""Capsules around the links of an arm."""

import numpy as np
import pytest

import dynident as dy
from dynident.models.capsules import body_capsules, bounding_balls, default_link_radius, fixed_boxes
from dynident.models.geometry import Solid, build_geometry
from dynident.models.robot_files import ShapeKind, rotation
from tests.apps.excitation.meshes import BENT
from tests.models.test_fitting import beyond, points
from tests.robots import joint, link, urdf


def shaped(name, *inside, mass=1.0):
    """A link with shapes for collision."""
    shapes = "".join(f"<collision>{x}</collision>" for x in inside)
    return link(name, mass).replace("</link>", f"{shapes}</link>") if mass else f'<link name="{name}">{shapes}</link>'


def at(xyz, shape):
    return f'<origin xyz="{xyz}"/><geometry>{shape}</geometry>'


def two_joints(*links):
    return urdf(
        *links,
        joint("one", "revolute", "base", "arm", (0.0, 0.0, 0.4)),
        joint("two", "revolute", "arm", "hand", (0.0, 0.3, 0.4)),
    )


def capsules(xml, meshes=None):
    return body_capsules(build_geometry(dy.RigidBodies(xml), (meshes or {}).get))


def test_balls_at_the_ends_of_a_cylinder_and_it_are_one_capsule() -> None:
    shapes = at("0 0 0", '<sphere radius="0.07"/>'), at("0 0 0.2", '<sphere radius="0.07"/>')
    tube = at("0 0 0.1", '<cylinder radius="0.07" length="0.2"/>')
    base, arm, hand = (shaped(name, *shapes, tube) for name in ("base", "arm", "hand"))
    test_capsules = capsules(two_joints(base, arm, hand))
    assert [(x.link, x.body) for x in test_capsules] == [("base", -1), ("arm", 0), ("hand", 1)]
    assert [x.radius for x in test_capsules] == pytest.approx([0.07] * 3, rel=0.03)


def test_a_bent_mesh_has_two_capsules_that_contain_it() -> None:
    mesh = at("0 0 0", '<mesh filename="bent.stl"/>')
    test_capsules = capsules(two_joints(shaped("base"), shaped("arm", mesh), shaped("hand")), {"bent.stl": BENT})
    around = [x for x in test_capsules if x.link == "arm"]
    assert len(around) == 2
    weights = np.random.default_rng(0).dirichlet(np.ones(3), 60)
    inside = np.einsum("wc,fci->fwi", weights, BENT.vertices[BENT.triangles]).reshape(-1, 3)
    out = np.min([beyond(x, points(inside)) for x in around], axis=0)
    assert out.max() < 1e-3


@pytest.mark.parametrize(
    ("kind", "size", "reach"),
    [
        (ShapeKind.BOX, (0.1, 0.2, 0.3), lambda d: np.abs(d) @ [0.1, 0.2, 0.3]),
        (ShapeKind.SPHERE, (0.1,), lambda d: np.full(len(d), 0.1)),
        (ShapeKind.CYLINDER, (0.1, 0.3), lambda d: 0.1 * np.linalg.norm(d[:, :2], axis=1) + 0.3 * np.abs(d[:, 2])),
        (ShapeKind.CAPSULE, (0.1, 0.3), lambda d: 0.1 + 0.3 * np.abs(d[:, 2])),
        (ShapeKind.ELLIPSOID, (0.1, 0.2, 0.3), lambda d: np.linalg.norm(d * [0.1, 0.2, 0.3], axis=1)),
    ],
)
def test_balls_reach_as_far_as_the_shape_in_every_direction(kind, size, reach) -> None:
    """And no more than round shapes by polygons of 16 corners do."""
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation(np.array([0.6, 0.0, 0.8]), 0.7), (1.0, 2.0, -3.0)
    balls = bounding_balls(Solid("a", 0, kind, size, frame))
    d = np.random.default_rng(0).normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    reached = (d @ (balls.centres - frame[:3, 3]).T + balls.radii).max(axis=1) / reach(d @ frame[:3, :3])
    assert (reached.min() > 1 - 1e-12, reached.max() < 1 / np.cos(np.pi / 16) ** 2 + 1e-12) == (True, True)


def test_links_without_shapes_have_capsules_between_their_joints() -> None:
    xml = two_joints(link("base"), link("arm", 1.0), link("hand", 1.0))
    test_capsules = capsules(xml)
    assert default_link_radius(dy.RigidBodies(xml)) == pytest.approx(0.05)  # a tenth of 0.5 m
    assert [(x.link, x.radius) for x in test_capsules] == [("arm", pytest.approx(0.05)), ("hand", pytest.approx(0.05))]
    assert sorted(np.array([test_capsules[0].start, test_capsules[0].end]).tolist()) == pytest.approx(
        np.array([[0, 0, 0], [0, 0.3, 0.4]]), abs=1e-3
    )


def test_a_table_that_stands_still_is_a_box() -> None:
    table = '<origin xyz="0 0 0.5" rpy="0 0 0.5"/><geometry><box size="1.2 0.7 1.0"/></geometry>'
    geometry = build_geometry(dy.RigidBodies(two_joints(shaped("base", table), shaped("arm"), shaped("hand"))))
    (box_,) = fixed_boxes(geometry)
    assert (box_.name, box_.centre, box_.size) == ("base", (0, 0, 0.5), (1.2, 0.7, 1.0))
    assert np.array(box_.axes) == pytest.approx(rotation(np.array([0, 0, 1.0]), 0.5).T)
    assert all(body_capsule.link != "base" for body_capsule in body_capsules(geometry))
