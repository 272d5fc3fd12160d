"""What is known of the shapes of an arm."""

import pytest

import dynident as dy
from dynident.models import ShapeSource
from dynident.models.geometry import build_geometry, link_places
from dynident.models.robot_files import ShapeKind
from tests.apps.excitation.meshes import box
from tests.robots import joint, link, urdf

BALL = '<geometry><sphere radius="0.1"/></geometry>'


def mesh(name):
    return f'<geometry><mesh filename="{name}"/></geometry>'


def arm(collision=(), visual=()):
    inside = "".join(
        f"<{tag}>{x}</{tag}>" for tag, given in (("collision", collision), ("visual", visual)) for x in given
    )
    part = link("arm", 1.0).replace("</link>", f"{inside}</link>")
    return dy.RigidBodies(urdf(link("base"), part, joint("one", "revolute", "base", "arm")))


@pytest.mark.parametrize(
    ("collision", "visual", "made", "kinds"),
    [
        ((BALL,), (mesh("there.stl"),), ShapeSource.COLLISION, [ShapeKind.SPHERE]),
        ((mesh("lost.stl"), BALL), (mesh("there.stl"),), ShapeSource.VISUAL, [ShapeKind.MESH]),
        ((mesh("lost.stl"), BALL), (mesh("lost.stl"),), ShapeSource.JOINTS, [ShapeKind.SPHERE]),
        ((), (mesh("there.stl"),), ShapeSource.VISUAL, [ShapeKind.MESH]),
        ((mesh("lost.stl"),), (), ShapeSource.JOINTS, []),
        ((), (), ShapeSource.JOINTS, []),
    ],
)
def test_which_shapes_of_a_link_are_used(collision, visual, made, kinds) -> None:
    bodies = arm(collision, visual)
    geometry = build_geometry(bodies, {"there.stl": box([0] * 3, [1] * 3)}.get)
    assert geometry.sources == {0: made}
    assert [solid.kind for solid in geometry.solids] == kinds


def test_links_that_stand_still_are_placed_by_locked_joints() -> None:
    xml = urdf(
        link("base"), link("table"), link("rail", 1.0), link("arm", 1.0),
        joint("stand", "fixed", "base", "table", (1.0, 0.0, 0.0)),
        joint("slide", "prismatic", "table", "rail", (0.0, 0.0, 0.5), axis=(0.0, 1.0, 0.0)),
        joint("one", "revolute", "rail", "arm"),
    )  # fmt: skip
    places = {link_place.link: link_place for link_place in link_places(dy.RigidBodies(xml, ("one",), {"slide": 0.3}))}
    assert {name: x.body for name, x in places.items()} == {"base": -1, "table": -1, "rail": -1, "arm": 0}
    assert places["rail"].frame[:3, 3] == pytest.approx([1.0, 0.3, 0.5])
